/* Is damper.c, as you compiled it, the step that was exported?
 *
 *     cc -std=c99 -O2 damper.c damper_sets.c selftest.c -lm -o selftest && ./selftest
 *
 * Every set goes along a motion, with steps and an actuation that change, to the forces of the
 * package's Python. Exit status 1: a force is off by more than 1e-9 of the largest, or a step that
 * must be refused is not.
 */
#include "damper.h"
#include "selftest_data.h"

#include <math.h>
#include <stdio.h>

static double actuation_unit(const damper_device *device) {
    if (device->actuation == DAMPER_PRESSURE) return DAMPER_KSI;
    return device->actuation == DAMPER_FORCE ? DAMPER_KIP : 1.0;
}

int main(void) {
    static damper device;
    double worst = 0.0;
    int i, k, code, failed = 0;
    for (i = 0; i < damper_set_count; i++) {
        const double unit = actuation_unit(damper_sets[i].device);
        damper_state state, before;
        double peak = 0.0, error = 0.0;
        code = damper_prepare(&device, damper_find(damper_sets[i].name));
        if (code == DAMPER_OK) code = damper_start(&state, &device, 0);
        for (k = 0; k < SELFTEST_SAMPLES && code >= 0; k++) {
            code = damper_step(&state, selftest_dt[k], selftest_x[k] * DAMPER_INCH,
                               selftest_v[k] * DAMPER_INCH, selftest_p[k] * unit);
            peak = fmax(peak, fabs(selftest_force[i][k]));
            error = fmax(error, fabs(state.force / DAMPER_KIP - selftest_force[i][k]));
        }
        if (code < 0 || !(error <= 1e-9 * peak)) {
            printf("set %s: code %d, error %g of the peak\n", damper_sets[i].name, code,
                   error / peak);
            failed = 1;
            continue;
        }
        worst = fmax(worst, error / peak);
        before = state;
        failed |= damper_step(&state, 0.0, 0.0, 0.0, selftest_p[0] * unit) != DAMPER_BAD_STEP;
        failed |= damper_step(&state, 0.01, NAN, 0.0, selftest_p[0] * unit) != DAMPER_BAD_STEP;
        if (damper_sets[i].device->actuation != DAMPER_NO_ACTUATION)
            failed |= damper_step(&state, 0.01, 0.0, 0.0, -unit) != DAMPER_BAD_ACTUATION;
        failed |= state.force != before.force || state.memory.z != before.memory.z;
    }
    printf("%d sets, largest error %.1e of the peak force: %s\n", damper_set_count, worst,
           failed ? "FAILED" : "passed");
    return failed;
}
