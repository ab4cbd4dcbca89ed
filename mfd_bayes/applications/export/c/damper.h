/* A calibrated friction damper, step by step: C99, no allocation, no globals, math.h alone.
 *
 *     damper device;
 *     damper_state state, trial;
 *     damper_prepare(&device, damper_find("nominal"));
 *     damper_start(&state, &device, 0);
 *     damper_step(&state, 0.0, x0, v0, actuation);        the first sample
 *     code = damper_step(&state, dt, x, v, actuation);    each later one
 *     force = state.force;
 *
 * A state is a plain struct: copy it to try a step, and copy it back to take the step again.
 * `damper_state` points to its `damper`, which must stay where it is.
 */
#ifndef DAMPER_H
#define DAMPER_H

#if defined(__FAST_MATH__) || defined(_M_FP_FAST)
#error "damper.c tells numbers from NaN and infinity: compile without -ffast-math or /fp:fast"
#endif

/* Your units, the one constant to change: 0 kip, in, ksi; 1 N, m, Pa; 2 kN, mm, MPa; 3 N, mm, MPa.
 * Time is in seconds. An actuation is a pressure, a force, or has the unit of the campaign. */
#ifndef DAMPER_UNITS
#define DAMPER_UNITS 0
#endif

#if DAMPER_UNITS == 0
#define DAMPER_INCH 1.0
#define DAMPER_KIP 1.0
#define DAMPER_KSI 1.0
#elif DAMPER_UNITS == 1
#define DAMPER_INCH 0.0254
#define DAMPER_KIP 4448.2216152605
#define DAMPER_KSI 6894757.293168361
#elif DAMPER_UNITS == 2
#define DAMPER_INCH 25.4
#define DAMPER_KIP 4.4482216152605
#define DAMPER_KSI 6.894757293168361
#elif DAMPER_UNITS == 3
#define DAMPER_INCH 25.4
#define DAMPER_KIP 4448.2216152605
#define DAMPER_KSI 6.894757293168361
#else
#error "DAMPER_UNITS must be 0, 1, 2 or 3"
#endif

enum { DAMPER_THREE_STAGE, DAMPER_LUGRE, DAMPER_BOUC_WEN, DAMPER_BACKLASH };
enum { DAMPER_PRESSURE, DAMPER_FORCE, DAMPER_OTHER, DAMPER_NO_ACTUATION };

/* What damper_start and damper_step return. Below 0 nothing was done: the state is as before. */
enum {
    DAMPER_OK = 0,
    DAMPER_UNTESTED = 1,        /* done, but at an actuation outside of the tested range */
    DAMPER_BAD_SET = -1,        /* no set, or one whose parameters cannot be */
    DAMPER_BAD_STEP = -2,       /* dt is not positive, or a number is not finite */
    DAMPER_BAD_ACTUATION = -3,  /* below 0, or outside of the range of the laws */
    DAMPER_NO_FORCE = -4        /* the force is no finite number at this step */
};

#define DAMPER_PARAMETERS 14
#define DAMPER_LAWS 3
#define DAMPER_LEVELS 40  /* most levels of actuation with a deviation from the laws */
#define DAMPER_KNOTS 302  /* of the curve of Bouc-Wen */

/* How a parameter follows the actuation p. Over its value at the set's level it is
 *     r(p) / r(level) exp(deviation at p),   r(p) = share (p / reference)^exponent + 1 - share,
 * with deviations that are linear in ln p between the levels, and stay beyond them. */
typedef struct {
    double share, exponent;
    double deviation[DAMPER_LEVELS];
} damper_law;

/* What the sets of a device have in common; kip, in, s and ksi (or the actuation's own unit). */
typedef struct {
    int model, actuation;      /* DAMPER_THREE_STAGE ..., DAMPER_PRESSURE ... */
    double level, reference;   /* actuation at which parameters stand; p0 of the laws */
    double tested[2], range[2];  /* actuations that were tested, and that a step takes */
    int levels;                /* number of levels with a deviation */
    double log_level[DAMPER_LEVELS];
} damper_device;

/* A parameter set: parameters in the order of the package's model, and the start in the gap. */
typedef struct {
    const char *name;
    const damper_device *device;
    double parameter[DAMPER_PARAMETERS];
    double start;
    damper_law law[DAMPER_LAWS];  /* of Fc_fwd, Fc_bwd (Fy of Bouc-Wen), sigma0 */
} damper_set;

/* Curve of Bouc-Wen's z in one direction, and its cells. */
typedef struct {
    double end, xi[DAMPER_KNOTS], w[DAMPER_KNOTS];
    double length[DAMPER_KNOTS], rise[DAMPER_KNOTS], entry[DAMPER_KNOTS], bend[DAMPER_KNOTS];
} damper_curve;

/* A device with a set: what is computed once of its parameters. */
typedef struct {
    const damper_set *set;
    double at_level[DAMPER_LAWS];                   /* r(level) of each law */
    double kinetic[2], excess[2];                   /* Stribeck curve over sigma0, both ways */
    double width, ell, early, late, build_up, jump; /* the gap of the three stages */
    double after[2];
    double onset[2], step, window;                  /* of the backlash: where slip sets in */
    damper_curve curve;
} damper;

/* A device at a sample of its motion. Lengths and forces are in your units, but for `memory`. */
typedef struct {
    const damper *device;
    double force;       /* the damper's force */
    double work;        /* done on it since the start: dissipated, and the little that it stores */
    double gap_travel;  /* way in the gap since it last slipped, from 0 to the gap's width */
    struct {            /* kip, in, s */
        int begun, moved;
        double displacement, velocity, actuation, factor[DAMPER_LAWS];
        double direction, z, slip, travelled;  /* z is a force of Bouc-Wen, else a deflection */
        double side, edge, origin, carry;      /* the gap of the three stages */
    } memory;
} damper_state;

/* Sets by name: "nominal", "lower", "upper", or a draw's number from "1"; NULL for others. */
extern const damper_set damper_sets[];
extern const int damper_set_count;
const damper_set *damper_find(const char *name);

int damper_prepare(damper *device, const damper_set *set);

/* direction of the first motion: 1, -1, or 0 to take that of the first velocity */
int damper_start(damper_state *state, const damper *device, int direction);

/* To the next sample, dt seconds after the last; at the first one dt does not matter. */
int damper_step(damper_state *state, double dt, double displacement, double velocity,
                double actuation);

#endif
