/* A storey with the damper's FMU (FMI 2.0) in an earthquake: a master without Python.
 *
 *     master LIBRARY TOKEN SET ACTUATION MASS STIFFNESS DAMPING STEP < accelerations
 *
 * In SI units. Newmark's average acceleration; in each step the force is iterated by secants, the
 * FMU going back to the state before it. Prints the largest displacement.
 */
#include <dlfcn.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

static void logger(void *e, const char *name, int s, const char *category, const char *m, ...) {
    va_list arguments;
    va_start(arguments, m);
    vfprintf(stderr, m, arguments);
    va_end(arguments);
    (void)e, (void)name, (void)s, (void)category;
}
static const struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *other[4];
} callbacks = {logger, {NULL, NULL, NULL, NULL}};

#define OF(name, result, ...) result (*name)(__VA_ARGS__) = (result (*)(__VA_ARGS__))dlsym(fmu, #name)
#define MUST(call) if ((call) > 1) return 3

int main(int count, char **word) {
    static const unsigned in[] = {0, 1, 2}, out[] = {3}, set[] = {7}, way[] = {8};
    const char *name[1];
    double p, m, k, c, h, ground, x = 0, v = 0, a = 0, force, rest, peak = 0, t = 0, value[3];
    void *fmu = count == 9 ? dlopen(word[1], RTLD_NOW) : NULL, *device, *state = NULL;
    int first = 1, direction[1], i;
    if (!fmu) return 2;
    OF(fmi2Instantiate, void *, const char *, int, const char *, const char *, const void *, int, int);
    OF(fmi2SetReal, int, void *, const unsigned *, size_t, const double *);
    OF(fmi2GetReal, int, void *, const unsigned *, size_t, double *);
    OF(fmi2SetString, int, void *, const unsigned *, size_t, const char **);
    OF(fmi2SetInteger, int, void *, const unsigned *, size_t, const int *);
    OF(fmi2ExitInitializationMode, int, void *);
    OF(fmi2GetFMUstate, int, void *, void **);
    OF(fmi2SetFMUstate, int, void *, void *);
    OF(fmi2DoStep, int, void *, double, double, int);
    p = atof(word[4]), m = atof(word[5]), k = atof(word[6]), c = atof(word[7]), h = atof(word[8]);
    device = fmi2Instantiate("damper", 1, word[2], "", &callbacks, 0, 0);
    if (!device) return 4;
    while (scanf("%lf", &ground) == 1) {
        double low, low_off, next, off, stiff = m + 0.5 * h * c + 0.25 * h * h * k;
        if (first) {
            value[0] = value[1] = 0, value[2] = p, name[0] = word[3];
            direction[0] = ground > 0 ? -1 : 1;
            MUST(fmi2SetString(device, set, 1, name));
            MUST(fmi2SetInteger(device, way, 1, direction));
            MUST(fmi2SetReal(device, in, 3, value));
            MUST(fmi2ExitInitializationMode(device));
            MUST(fmi2GetReal(device, out, 1, &rest));
            force = rest, a = -ground, first = 0;
            continue;
        }
        MUST(fmi2GetFMUstate(device, &state));
        low = force, low_off = 0, next = force;
        for (i = 0; i < 60; i++) {
            double load = -m * ground - (next - rest) - c * (v + 0.5 * h * a);
            double a1 = (load - k * (x + h * v + 0.25 * h * h * a)) / stiff;
            MUST(fmi2SetFMUstate(device, state));
            value[0] = x + h * v + 0.25 * h * h * (a + a1), value[1] = v + 0.5 * h * (a + a1);
            MUST(fmi2SetReal(device, in, 2, value));
            MUST(fmi2DoStep(device, t, h, 0));
            MUST(fmi2GetReal(device, out, 1, &force));
            off = force - next, value[2] = a1;
            if (fabs(off) <= 1e-9 * (1 + fabs(force))) break;
            force = i && off != low_off ? next - off * (next - low) / (off - low_off) : next + 0.5 * off;
            low = next, low_off = off, next = force;
        }
        x = value[0], v = value[1], a = value[2], t += h;
        peak = fmax(peak, fabs(x));
    }
    printf("%.17g\n", peak);
    return 0;
}
