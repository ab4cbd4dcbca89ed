/* The step of the package's models, written by hand after their Python; docs: "The model".
 *
 * Between two samples the velocity is taken as constant. A motion that turns between them goes
 * through its vertex. What follows works in kip, in and s; units are converted in damper_step.
 */
#include "damper.h"

#include <math.h>
#include <stddef.h>

#define FLOOR 1e-9       /* least slip force, kip, and stiffness, kip/in: nothing divides by zero */
#define FLOOR_SHARE 1e-6 /* least share of a slip force that is left without actuation */
#define LARGEST 1e100    /* largest ratio that a law gives */

static double least(double a, double b) { return a < b ? a : b; }
static double most(double a, double b) { return a > b ? a : b; }
static double between(double x, double low, double high) { return most(low, least(x, high)); }

/* --- the laws of the actuation */

/* Parameters of each law, by model: kinetic and static friction forward, backward, stiffness. */
static const int FOLLOWS[4][DAMPER_LAWS][2] = {
    {{4, 3}, {6, 5}, {0, -1}},   /* three_stage: Fc_fwd Fs_fwd, Fc_bwd Fs_bwd, sigma0 */
    {{4, 3}, {6, 5}, {0, -1}},   /* lugre */
    {{2, -1}, {3, -1}, {-1, -1}},  /* bouc_wen: Fy_fwd, Fy_bwd */
    {{5, -1}, {6, -1}, {-1, -1}},  /* backlash: Fc_fwd, Fc_bwd */
};

static double ratio(const damper_law *law, double relative) {
    double power = relative > 0.0 ? least(exp(log(relative) * law->exponent), LARGEST) : 0.0;
    return law->share * power + (1.0 - law->share);
}

/* Factors of the laws at an actuation. */
static void factors_at(const damper *device, double actuation, double *factor) {
    const damper_device *common = device->set->device;
    const double *log_level = common->log_level;
    int last = common->levels - 1, cell = 0, k;
    double share = 0.0;
    if (last > 0) {
        double position = between(log(most(actuation, 1e-300)), log_level[0], log_level[last]);
        while (cell < last - 1 && position >= log_level[cell + 1]) cell++;
        share = (position - log_level[cell]) / (log_level[cell + 1] - log_level[cell]);
    }
    for (k = 0; k < DAMPER_LAWS; k++) {
        const damper_law *law = &device->set->law[k];
        const double *deviation = &law->deviation[cell];
        factor[k] = 1.0;
        if (common->actuation == DAMPER_NO_ACTUATION) continue;
        if (device->at_level[k] > 0.0)
            factor[k] = ratio(law, actuation / common->reference) / device->at_level[k];
        if (last > 0) factor[k] *= exp((1.0 - share) * deviation[0] + share * deviation[1]);
    }
}

/* Parameters under factors of the laws. */
static void scaled(const damper *device, const double *factor, double *parameter) {
    const damper_set *set = device->set;
    int k, j;
    for (k = 0; k < DAMPER_PARAMETERS; k++) parameter[k] = set->parameter[k];
    for (k = 0; k < DAMPER_LAWS; k++)
        for (j = 0; j < 2; j++)
            if (FOLLOWS[set->device->model][k][j] >= 0)
                parameter[FOLLOWS[set->device->model][k][j]] *= factor[k];
}

/* --- LuGre friction (model.md section 2) */

/* Stribeck curve over sigma0, in: F_c and F_s - F_c, forward and, negative, backward. */
static void stribeck(const double *c, double *kinetic, double *excess) {
    double stiff = most(c[0], FLOOR);
    double forward = most(c[4], FLOOR), backward = most(c[6], FLOOR);
    kinetic[0] = forward / stiff;
    kinetic[1] = -backward / stiff;
    excess[0] = most(c[3] - forward, 0.0) / stiff;
    excess[1] = -most(c[5] - backward, 0.0) / stiff;
}

/* F1 after a straight way: z' = a z + (1 - a) sgn(v) g / sigma0 with a = exp(-sigma0 |way| / g). */
static void bristles(const damper *device, damper_state *s, const double *factor, double x,
                     double v, double dt) {
    const double *c = device->set->parameter;
    double now[DAMPER_PARAMETERS], mean[DAMPER_PARAMETERS], pair[DAMPER_LAWS];
    double kinetic[2], excess[2];
    double way = x - s->memory.displacement, rate = way / dt, steady, damping;
    double v_s = c[device->set->device->model == DAMPER_LUGRE ? 7 : 13];
    int backward = rate < 0.0, varying = 0, k;
    for (k = 0; k < DAMPER_LAWS; k++) {
        varying |= factor[k] != 1.0 || s->memory.factor[k] != 1.0;
        pair[k] = 0.5 * (factor[k] + s->memory.factor[k]);
    }
    if (varying) {
        scaled(device, factor, now);
        scaled(device, pair, mean);
        stribeck(mean, kinetic, excess);
        c = now;
    } else {
        for (k = 0; k < 2; k++) {
            kinetic[k] = device->kinetic[k];
            excess[k] = device->excess[k];
        }
    }
    steady = kinetic[backward] + excess[backward] * exp(-rate * rate / (v_s * v_s));
    s->memory.z = steady + exp(-way / steady) * (s->memory.z - steady);
    damping = copysign(v, rate) / steady;
    if (varying) { /* friction that fell while at rest must not make the damping larger */
        double largest = most(most(c[3], c[5]), FLOOR) / most(least(c[4], c[6]), FLOOR);
        damping *= least(1.0, largest / most(fabs(s->memory.z / steady), 1e-300));
    }
    s->memory.slip = (c[0] - c[1] * damping) * s->memory.z + (c[1] + c[2]) * v;
}

/* --- the three stages and their gap (model.md sections 3 and 4) */

#define SATURATED 26.0  /* transition lengths after which a transition is complete */
#define FARTHEST 150.0  /* largest exponent: the product of three exponentials is a number */

static double logistic(double x) { return 1.0 / (1.0 + exp(-x)); }

static void prepare_gap(damper *device) {
    const double *c = device->set->parameter;
    device->width = c[9] + c[10];
    device->ell = c[12] / c[11];
    device->early = c[9] / device->ell;
    device->late = device->width / device->ell;
    device->build_up = logistic(device->late) * logistic(-device->early);
    device->jump = (c[7] - c[8]) * c[9];
    device->after[0] = exp(-device->early);
    device->after[1] = exp(-device->late);
}

/* Force of the stages at y from the origin of the gap, where friction alone has `slip`. */
static double blend(const damper *device, double side, double y, double carry, double slip) {
    const double *c = device->set->parameter;
    double u = side * y / device->ell, r = exp(between(u, -SATURATED, FARTHEST)), a, b, q;
    double stick = c[7] * y - slip, force = c[8] * y + side * device->jump - slip, fading;
    if (device->late > FARTHEST) {
        a = exp(least(u - device->early, FARTHEST));
        b = exp(least(u - device->late, FARTHEST));
    } else {
        a = r * device->after[0];
        b = r * device->after[1];
    }
    fading = most(r, 1.0 / r) + 1.0;
    q = 0.5 * (most(r, 1.0) + 1.0);
    force = ((force * a + stick) * q - stick) / ((1.0 + a) * (1.0 + b) * q);
    return force + 2.0 * carry / fading + slip;
}

static void place_gap(const damper *device, damper_state *s, double side, double edge,
                      double carry) {
    s->memory.side = side;
    s->memory.edge = edge;
    s->memory.origin = side > 0.0 ? edge : edge + device->width;
    s->memory.carry = carry;
}

static void begin_gap(const damper *device, damper_state *s, double x, double direction) {
    double start = device->set->start, share = direction > 0.0 ? start : 1.0 - start;
    place_gap(device, s, direction, x - share * device->width, 0.0);
}

/* A turn at x into a direction: after slip the travel restarts, inside the gap nothing changes. */
static void turn_gap(const damper *device, damper_state *s, double x, double slip,
                     double direction) {
    double edge = least(most(s->memory.edge, x - device->width), x);
    double carry = s->memory.carry, side = s->memory.side;
    if (edge == x || edge == x - device->width) {
        double y = x - s->memory.origin, u = side * y;
        double jump = device->build_up * (slip - direction * device->jump);
        if (u < device->width + SATURATED * device->ell)
            jump += blend(device, side, y, 0.0, slip) - slip;
        carry = (1.0 - tanh(fabs(u) / (2.0 * device->ell))) * carry + jump;
        side = direction;
    }
    place_gap(device, s, side, edge, carry);
}

/* --- Bouc-Wen (model.md; Gregory and Delbourgo's rational quadratic spline between the knots) */

#define NEAR 2e-9  /* distance from w = 1 at which z has reached F_y */
#define REACH 4.0  /* the curve is resolved down to -REACH times the ratio of the two F_y */
#define FAR 1e7    /* factor by which w may go below that range after friction has fallen */
#define CELLS 96   /* of each part of the curve */
#define ZERO 108   /* knot of w = 0: after 12 below the range, and CELLS */

static double curve_slope(double w, double power, double soft) {
    double grown = exp(least(power * log(most(fabs(w), 1e-300)), 200.0));
    return most(w < 0.0 ? 1.0 + soft * grown : fabs(grown - 1.0), 1e-300);
}

/* w = z / F_y against xi = k |x| / F_y: dw/dxi = 1 + (2 beta - 1) |w|^n below 0, else 1 - |w|^n. */
static void prepare_curve(damper *device) {
    /* nodes and weights of Gauss and Legendre */
    static const double node[4] = {-0.8611363115940526, -0.33998104358485626, 0.33998104358485626,
                                   0.8611363115940526};
    static const double weight[4] = {0.34785484513745385, 0.6521451548625461, 0.6521451548625461,
                                     0.34785484513745385};
    const double *c = device->set->parameter;
    damper_curve *curve = &device->curve;
    double power = c[5], soft = 2.0 * c[4] - 1.0;
    double reach = REACH * most(c[2], c[3]) / least(c[2], c[3]);
    int i, j, gap = ZERO + CELLS;
    for (i = 0; i < 12; i++) curve->w[i] = -reach * pow(FAR, (96.0 - 8.0 * i) / CELLS);
    for (i = 0; i < CELLS; i++)
        curve->w[12 + i] = -expm1((double)(CELLS - i) / CELLS * log1p(reach));
    for (i = 0; i <= CELLS; i++) {
        double y = (double)i / CELLS, log_near = log(NEAR);
        curve->w[ZERO + i] = 1.0 - exp(log_near * pow(y, 1.5));
        curve->w[gap + 1 + i] = 1.0 + exp(log_near + y * (log(reach - 1.0) - log_near));
    }
    for (i = 0; i < DAMPER_KNOTS - 1; i++) {
        double half = 0.5 * (curve->w[i + 1] - curve->w[i]), middle = curve->w[i] + half;
        double sum = 0.0, leave;
        for (j = 0; j < 4; j++)
            sum += weight[j] / curve_slope(middle + half * node[j], power, soft);
        curve->rise[i] = 2.0 * half;
        curve->length[i] = i == gap ? 1.0 : half * sum;
        curve->entry[i] = curve_slope(curve->w[i], power, soft) * curve->length[i] / (2.0 * half);
        leave = curve_slope(curve->w[i + 1], power, soft) * curve->length[i] / (2.0 * half);
        curve->bend[i] = curve->entry[i] + leave - 2.0;
    }
    /* counted from xi = 0, where small numbers are exact */
    curve->xi[ZERO] = 0.0;
    for (i = ZERO; i < DAMPER_KNOTS - 1; i++) curve->xi[i + 1] = curve->xi[i] + curve->length[i];
    for (i = ZERO; i > 0; i--) curve->xi[i - 1] = curve->xi[i] - curve->length[i - 1];
    curve->end = curve->xi[gap];
}

static int cell_of(const double *knots, double value) {
    int low = 0, high = DAMPER_KNOTS - 1; /* the last cell begins at the knot before the last */
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (knots[middle] <= value) low = middle;
        else high = middle;
    }
    return low;
}

static double curve_value(const damper_curve *curve, double xi) {
    int i = cell_of(curve->xi, xi);
    double t = between((xi - curve->xi[i]) / curve->length[i], 0.0, 1.0), u = 1.0 - t;
    return curve->w[i] + curve->rise[i] * t * (curve->entry[i] * u + t) /
                             (1.0 + curve->bend[i] * t * u);
}

static double curve_place(const damper_curve *curve, double w) {
    int i = cell_of(curve->w, w);
    double share = between((w - curve->w[i]) / curve->rise[i], 0.0, 1.0);
    double b = curve->entry[i] - share * curve->bend[i];
    double root = sqrt(most(b * b + 4.0 * (1.0 - b) * share, 0.0));
    double t = b >= 0.0 ? 2.0 * share / most(b + root, 1e-300)
                        : (root - b) / most(2.0 - 2.0 * b, 1.0);
    return curve->xi[i] + curve->length[i] * t;
}

/* z, kip, after a straight way */
static void hysteresis(const damper *device, damper_state *s, const double *factor, double x) {
    const double *c = device->set->parameter;
    const damper_curve *curve = &device->curve;
    double way = x - s->memory.displacement, strength, xi, length, moved;
    int k = way > 0.0 ? 0 : 1;
    if (way == 0.0) return;
    strength = c[2 + k] * most(0.5 * (s->memory.factor[k] + factor[k]), FLOOR_SHARE);
    if (k) strength = -strength;
    xi = curve_place(curve, s->memory.z / strength);
    length = c[0] / fabs(strength) * fabs(way);
    moved = least(xi + length, curve->end);
    if (xi > curve->end + 0.5) moved = most(xi - length, curve->end + 1.0);
    s->memory.z = curve_value(curve, moved) * strength;
}

/* --- LuGre in series with a spring that has a gap (model.md section 9) */

#define FINE 1.7          /* longest step near a turn over the length in which slip sets in */
#define COARSE 0.34       /* and n times it */
#define SURE 7.0          /* way after which it surely slips */
#define MOST_FINE 256.0   /* steps near a turn */
#define LOOSE 2.0         /* in slip a step may be longer by this */
#define MOST_LOOSE 8.0    /* steps in slip */
#define MOST_CLOSE 128.0  /* a way that would have more is not cut */
#define STEPS 136         /* most steps of a way */
#define STIFF 8.0         /* a longer step ends in slip, or slides none */
#define OVER 1.0          /* largest n ln(G/g) at which a step begins */
#define TINY 1e-12        /* force, kip, that stands for one that does not push against friction */
#define CLOSE 8e-7        /* a step is solved when Newton moves it less; where n < 2: */
#define CLOSE_BLUNT 2e-7
#define FAR_OFF 1e13      /* error, over its limit, from which Newton may be beyond friction */

static double softplus(double a) { return log1p(exp(-fabs(a))) + most(a, 0.0); }

/* ln(1 + e) of e >= 0, which is e itself where the square is rounding */
static double log_of(double e) { return e < 1e-8 ? e : log1p(e); }

/* Force of the spring at a deflection, kip, and its stiffness, kip/in. One exponential serves the
 * softplus and its derivative, the logistic function. */
static double spring(const double *c, double z, double *slope) {
    double forward = (z - 0.5 * c[2]) / c[3], backward = -(z + 0.5 * c[2]) / c[3];
    double e = exp(-fabs(forward)), f = exp(-fabs(backward));
    *slope = c[0] * (forward > 0.0 ? 1.0 : e) / (1.0 + e) +
             c[1] * (backward > 0.0 ? 1.0 : f) / (1.0 + f) + c[4];
    return c[0] * c[3] * (log_of(e) + most(forward, 0.0)) -
           c[1] * c[3] * (log_of(f) + most(backward, 0.0)) + c[4] * z;
}

/* About the deflection s z where s G is a force of at least 0. */
static double about(const double *c, double force, double sign) {
    double half = 0.5 * c[2], stiff = sign > 0.0 ? c[0] : c[1], now, slope;
    double sharp = (half + force / stiff) / (1.0 + c[4] / stiff);
    double load = most((force - c[4] * sharp) / (stiff * c[3]), 1e-6);
    double ahead = half + c[3] * (load + log(-expm1(-load)));
    now = spring(c, sign * ahead, &slope);
    return ahead - (sign * now - force) / most(slope, 1e-300);
}

/* Deflection at which the force is G: Newton inside bounds, which are bisected where it leaves. */
static double deflection(const double *c, double force, double close) {
    double softest = least(c[0], c[1]), size = fabs(force);
    double uneven = log1p(most(c[0], c[1]) / softest);
    double high = 0.5 * c[2] + c[3] * (2.0 + uneven) + size / softest, low = -high;
    double sign = force > 0.0 ? 1.0 : force < 0.0 ? -1.0 : 0.0, z, slope, step, trial;
    int i;
    z = sign * between(about(c, size, sign), 0.0, high);
    for (i = 0; i < 60; i++) {
        double error = spring(c, z, &slope) - force;
        step = error / most(slope, 1e-300);
        if (fabs(step) <= close * (c[3] + fabs(z))) return z - step;
        if (error < 0.0) low = z;
        if (error > 0.0) high = z;
        trial = z - step;
        z = trial >= low && trial <= high ? trial : 0.5 * (low + high);
    }
    return z;
}

static double steepest(const damper *device) { return most(device->onset[0], device->onset[1]); }

static void prepare_backlash(damper *device) {
    const double *c = device->set->parameter;
    double slope, length, reach = 0.0;
    int k;
    for (k = 0; k < 2; k++) {
        double slip = k ? -c[6] : c[5];
        spring(c, deflection(c, slip, 1e-4), &slope);
        device->onset[k] = c[7] * slope / c[5 + k];
        reach += c[5 + k] * (1.0 + c[9 + k]) / c[k];
    }
    length = 1.0 / steepest(device);
    device->step = least(FINE, COARSE * c[7]) * length;
    device->window =
        between(c[2] + reach + SURE * length, device->step, MOST_FINE * device->step);
}

/* Logarithm n ln G and n G'/G, where G pushes against the motion. */
static double push(double ahead, double slope, double n, double *share) {
    *share = n < 2.0 && !(ahead > 0.0) ? 0.0 : slope * n;
    ahead = most(ahead, TINY);
    *share /= ahead;
    return n * log(ahead);
}

/* Spring force and deflection after a straight way that slides, kip and in; 0 if it is solved.
 *
 * The way is cut into steps h, short where slip sets in. All are solved together, by Newton's
 * method, for the two-point Hermite rule
 *     12 (zeta1 - zeta0) = h [(6 - c0) f0 + (6 + c1) f1],   f = 1 - (G/g)^n,   c = -h f'. */
static int slide(const damper *device, double *z, double *force, double way, double sign,
                 double travel, double dt, const double *before, const double *after) {
    const double *c = device->set->parameter;
    double n = c[7], rate = steepest(device), blunt = n < 2.0 ? CLOSE_BLUNT : CLOSE;
    double error = (rate / blunt) * (rate / blunt), bend = 1.0 - 1.0 / n;
    double level[STEPS], bound[STEPS], length[STEPS], h[STEPS], at[STEPS + 1], step[STEPS];
    double slipped[STEPS], value, stiff, first_log, first_share;
    double speed = way / dt, stribeck_share = exp(-speed * speed / (c[11] * c[11]));
    double fine, coarse, close, loose, sum, offset, ended;
    int stuck[STEPS], count, k, i, side = sign < 0.0;

    way = fabs(way);
    fine = least(most(device->window - travel, 0.0), way);
    coarse = way - fine;
    close = fine / device->step;
    loose = coarse / (LOOSE * device->step);
    close = close <= MOST_CLOSE ? ceil(close) : 1.0;
    loose = loose <= MOST_CLOSE ? ceil(least(loose, MOST_LOOSE)) : 1.0;
    if (close + loose == 0.0) close = 1.0;
    count = (int)(close + loose);
    if (count < 1) return 1;
    for (k = 0, sum = 0.0; k < count; k++) {
        double share, factor, slip;
        int first = k < (int)close, same = k > 0 && before[side] == after[side];
        h[k] = first ? fine / close : coarse / most(loose, 1.0);
        offset = first ? 0.0 : fine - close * h[k];
        share = between((offset + (k + 0.5) * h[k]) / most(way, 1e-300), 0.0, 1.0);
        factor = most(before[side] + share * (after[side] - before[side]), FLOOR_SHARE);
        slip = c[5 + side] * (1.0 + c[9 + side] * stribeck_share) * factor;
        length[k] = least(factor, 1.0) / rate;
        level[k] = same ? level[k - 1] : log(slip);
        bound[k] = same ? bound[k - 1] : about(c, slip, sign);
        stuck[k] = h[k] > STIFF * length[k]; /* so long that slip sets in at once, or not at all */
        if (stuck[k]) slipped[k] = sign * deflection(c, sign * exp(level[k]), 1e-13);
    }
    /* a first guess: unloading, a rounded corner where slip sets in, and slip */
    at[0] = *z;
    sum = most((bound[0] - sign * *z) * rate, 1e-300);
    offset = sign * *z * rate - log(-expm1(-sum));
    for (k = 0, sum = 0.0; k < count; k++) {
        sum += h[k];
        at[k + 1] = sign * (bound[k] - softplus((bound[k] - sum) * rate - offset) / rate);
    }
    value = spring(c, at[0], &stiff);
    first_log = push(sign * value, stiff, n, &first_share);
    for (i = 0; i < 100; i++) {
        double moved = 0.0, log0 = first_log, share0 = first_share, delta = 0.0, last = 0.0;
        for (k = 0; k < count; k++) {
            double z0 = at[k], end = at[k + 1], start = log0 - n * level[k], share = share0;
            double p, f, b, cf, t, decay, gain, ready;
            int exceeds = start > OVER && h[k] > 0.0;
            /* (G/g)^n before the step: that after the last one where g is the same */
            ready = k && level[k] == level[k - 1] && start <= OVER ? last : exp(least(start, OVER));
            if (exceeds) { /* what is far beyond slip is let go at once */
                double largest = exp(level[k] + OVER / n);
                z0 = deflection(c, sign * largest, 1e-13);
                spring(c, z0, &share);
                share *= n / largest;
            }
            value = spring(c, end, &stiff);
            log0 = push(sign * value, stiff, n, &share0);
            p = last = exp(least(log0 - n * level[k], STIFF));
            f = 1.0 - p;
            b = share0 * h[k];
            cf = b * p;
            gain = f * (6.0 + cf);
            t = cf * (6.0 + cf - bend * b * f) + 12.0;
            f = 1.0 - ready;
            b = share * h[k];
            cf = b * ready;
            gain += f * (6.0 - cf);
            decay = exceeds ? 0.0 : (12.0 - cf * (6.0 - cf + bend * b * f)) / t;
            gain = (gain * sign * h[k] + 12.0 * (z0 - end)) / t;
            if (stuck[k]) {
                double elastic = sign * at[k] + h[k];
                decay = elastic < slipped[k];
                gain = sign * least(elastic, slipped[k]) - end;
            }
            delta = (k ? decay * delta : 0.0) + gain;
            step[k] = delta;
            moved += delta * delta;
        }
        moved *= error;
        if (!isfinite(moved)) return 1;
        ended = value + stiff * step[count - 1];
        for (k = 0; k < count; k++) {
            at[k + 1] += step[k];
            if (moved > FAR_OFF && i < 6 && h[k] > 0.0)
                at[k + 1] = sign * least(sign * at[k + 1], bound[k] + 2.0 * length[k]);
        }
        if (moved <= 1.0) {
            *force = ended;
            *z = at[count];
            return 0;
        }
    }
    return 1;
}

static int backlash(const damper *device, damper_state *s, const double *factor, double x,
                    double dt) {
    const double *c = device->set->parameter;
    double way = x - s->memory.displacement, travel, slope, z = s->memory.z + way;
    double sign = way > 0.0 ? 1.0 : way < 0.0 ? -1.0 : s->memory.direction;
    double force = spring(c, z, &slope);
    if (sign == 0.0) sign = 1.0;
    travel = sign == s->memory.direction ? s->memory.travelled : 0.0;
    if (!(sign * force <= 0.0)) { /* where the spring still pushes with the motion nothing slid */
        z = s->memory.z;
        if (slide(device, &z, &force, way, sign, travel, dt, s->memory.factor, factor)) return 1;
    }
    s->memory.z = z;
    s->memory.slip = force;
    s->memory.direction = sign;
    s->memory.travelled = travel + fabs(way);
    return 0;
}

/* --- all models */

#define SMOOTH 0.1 /* share of a step by which a turn may differ from constant acceleration */

const damper_set *damper_find(const char *name) {
    int i, k;
    for (i = 0; name && i < damper_set_count; i++) {
        for (k = 0; name[k] && name[k] == damper_sets[i].name[k]; k++) continue;
        if (name[k] == damper_sets[i].name[k]) return &damper_sets[i];
    }
    return NULL;
}

int damper_prepare(damper *device, const damper_set *set) {
    /* a letter for each parameter: + must be above 0, 1 at least 1, 0 at least 0 */
    static const char limits[4][DAMPER_PARAMETERS + 1] = {"+0000000000+++", "+000000+", "+0++010",
                                                          "++0+0++1000+"};
    int k, model;
    if (!device || !set || !set->device) return DAMPER_BAD_SET;
    model = set->device->model;
    if (model < 0 || model > 3 || !(set->start >= 0.0 && set->start <= 1.0)) return DAMPER_BAD_SET;
    if (set->device->levels < 0 || set->device->levels > DAMPER_LEVELS) return DAMPER_BAD_SET;
    for (k = 0; limits[model][k]; k++) {
        double value = set->parameter[k];
        if (!isfinite(value) || value < (limits[model][k] == '1')) return DAMPER_BAD_SET;
        if (value == 0.0 && limits[model][k] == '+') return DAMPER_BAD_SET;
    }
    device->set = set;
    for (k = 0; k < DAMPER_LAWS; k++)
        device->at_level[k] = ratio(&set->law[k], set->device->level / set->device->reference);
    if (model == DAMPER_THREE_STAGE || model == DAMPER_LUGRE)
        stribeck(set->parameter, device->kinetic, device->excess);
    device->width = 0.0;
    if (model == DAMPER_THREE_STAGE) prepare_gap(device);
    if (model == DAMPER_BOUC_WEN) prepare_curve(device);
    if (model == DAMPER_BACKLASH) prepare_backlash(device);
    return DAMPER_OK;
}

int damper_start(damper_state *state, const damper *device, int direction) {
    static const damper_state nothing; /* all zeros */
    if (!state || !device || !device->set) return DAMPER_BAD_SET;
    if (direction < -1 || direction > 1) return DAMPER_BAD_STEP;
    *state = nothing;
    state->device = device;
    state->memory.direction = direction;
    return DAMPER_OK;
}

/* The first sample: bristles undeflected, the gap at its start. */
static void begin(const damper *device, damper_state *s, double x, double v) {
    const double *c = device->set->parameter;
    double slope, low, high;
    switch (device->set->device->model) {
    case DAMPER_THREE_STAGE:
    case DAMPER_LUGRE:
        s->memory.moved = s->memory.direction != 0.0;
        if (!s->memory.moved) s->memory.direction = v < 0.0 ? -1.0 : 1.0;
        s->memory.slip = (c[1] + c[2]) * v;
        if (device->set->device->model == DAMPER_THREE_STAGE)
            begin_gap(device, s, x, s->memory.direction);
        break;
    case DAMPER_BOUC_WEN: s->memory.origin = x; break;
    default:
        low = -0.5 * c[2] - c[6] / c[1];
        high = 0.5 * c[2] + c[5] / c[0];
        s->memory.z = low + device->set->start * (high - low);
        s->memory.slip = spring(c, s->memory.z, &slope);
        s->memory.direction = 0.0; /* no direction has to be known before the motion */
    }
    s->memory.begun = 1;
}

/* A straight way to a sample; not 0 where no force is found. */
static int advance(const damper *device, damper_state *s, const double *factor, double x, double v,
                   double dt) {
    int model = device->set->device->model, k;
    if (model == DAMPER_THREE_STAGE || model == DAMPER_LUGRE) {
        double way = x - s->memory.displacement, slip = s->memory.slip;
        bristles(device, s, factor, x, v, dt);
        if (way * s->memory.direction < 0.0) {
            s->memory.direction = -s->memory.direction;
            if (model == DAMPER_THREE_STAGE && s->memory.moved)
                turn_gap(device, s, s->memory.displacement, slip, s->memory.direction);
            else if (model == DAMPER_THREE_STAGE) /* the direction was assumed: the other one */
                begin_gap(device, s, s->memory.displacement, s->memory.direction);
        }
        s->memory.moved |= way != 0.0;
    } else if (model == DAMPER_BOUC_WEN) {
        hysteresis(device, s, factor, x);
    } else if (backlash(device, s, factor, x, dt)) {
        return 1;
    }
    s->memory.displacement = x;
    s->memory.velocity = v;
    for (k = 0; k < DAMPER_LAWS; k++) s->memory.factor[k] = factor[k];
    return 0;
}

static double total(const damper *device, const damper_state *s) {
    const double *c = device->set->parameter;
    switch (device->set->device->model) {
    case DAMPER_THREE_STAGE:
        return blend(device, s->memory.side, s->memory.displacement - s->memory.origin,
                     s->memory.carry, s->memory.slip);
    case DAMPER_LUGRE: return s->memory.slip;
    case DAMPER_BOUC_WEN:
        return c[1] * c[0] * (s->memory.displacement - s->memory.origin) +
               (1.0 - c[1]) * s->memory.z + c[6] * s->memory.velocity;
    default: return s->memory.slip + c[8] * s->memory.velocity;
    }
}

static double in_gap(const damper *device, const damper_state *s) {
    double width = device->width;
    switch (device->set->device->model) {
    case DAMPER_THREE_STAGE:
        return between(s->memory.side * (s->memory.displacement - s->memory.origin), 0.0, width);
    case DAMPER_BACKLASH:
        width = device->set->parameter[2];
        return between(0.5 * width + (s->memory.direction < 0.0 ? -1.0 : 1.0) * s->memory.z, 0.0,
                       width);
    default: return 0.0;
    }
}

/* Share of a step at which a motion turns, and the vertex; 0 where the step has no regular one. */
static int vertex_of(const damper_state *s, double dt, double x, double v, double *share,
                     double *vertex) {
    double speed = fabs(s->memory.velocity), next = fabs(v), moved = x - s->memory.displacement;
    double sign = s->memory.velocity < 0.0 ? -1.0 : 1.0, misfit;
    if (!(s->memory.velocity * v < 0.0)) return 0;
    *share = speed / (speed + next);
    if (sign * moved <= 0.0) /* the extreme sample is the one before */
        *vertex = s->memory.displacement + sign * 0.5 * dt * speed * *share;
    else
        *vertex = x + sign * 0.5 * dt * next * (1.0 - *share);
    misfit = fabs(moved - 0.5 * dt * (s->memory.velocity + v));
    return misfit <= SMOOTH * dt * (speed + next) && fabs(*share - 0.5) < 0.499;
}

int damper_step(damper_state *state, double dt, double displacement, double velocity,
                double actuation) {
    const damper *device;
    const damper_device *common;
    damper_state next;
    double factor[DAMPER_LAWS], at_vertex[DAMPER_LAWS], share, vertex;
    double x = displacement / DAMPER_INCH, v = velocity / DAMPER_INCH, p = actuation, force;
    int code = DAMPER_OK, k;
    if (!state || !state->device) return DAMPER_BAD_SET;
    device = state->device;
    common = device->set->device;
    if (!isfinite(x) || !isfinite(v)) return DAMPER_BAD_STEP;
    if (state->memory.begun && !(isfinite(dt) && dt > 0.0)) return DAMPER_BAD_STEP;
    if (common->actuation == DAMPER_NO_ACTUATION) {
        p = common->level;
    } else {
        if (common->actuation == DAMPER_PRESSURE) p /= DAMPER_KSI;
        if (common->actuation == DAMPER_FORCE) p /= DAMPER_KIP;
        if (!(isfinite(p) && p >= common->range[0] && p <= common->range[1]))
            return DAMPER_BAD_ACTUATION;
        if (p < common->tested[0] || p > common->tested[1]) code = DAMPER_UNTESTED;
    }
    next = *state;
    if (state->memory.begun && p == state->memory.actuation)
        for (k = 0; k < DAMPER_LAWS; k++) factor[k] = state->memory.factor[k];
    else
        factors_at(device, p, factor);
    next.memory.actuation = p;
    if (!state->memory.begun) {
        next.memory.displacement = x;
        next.memory.velocity = v;
        for (k = 0; k < DAMPER_LAWS; k++) next.memory.factor[k] = factor[k];
        begin(device, &next, x, v);
    } else {
        if (vertex_of(state, dt, x, v, &share, &vertex)) {
            for (k = 0; k < DAMPER_LAWS; k++)
                at_vertex[k] = share < 0.5 ? state->memory.factor[k] : factor[k];
            if (advance(device, &next, at_vertex, vertex, 0.0, share * dt)) return DAMPER_NO_FORCE;
            dt *= 1.0 - share;
        }
        if (advance(device, &next, factor, x, v, dt)) return DAMPER_NO_FORCE;
    }
    force = total(device, &next);
    next.force = force * DAMPER_KIP;
    if (state->memory.begun)
        next.work += 0.5 * (state->force + next.force) * (x - state->memory.displacement) *
                     DAMPER_INCH;
    next.gap_travel = in_gap(device, &next) * DAMPER_INCH;
    if (!isfinite(next.force) || !isfinite(next.work)) return DAMPER_NO_FORCE;
    *state = next;
    return code;
}
