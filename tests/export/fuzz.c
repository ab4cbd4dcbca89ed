/* Motions of every kind through every set: a sanitizer, or a force that is no number, ends it. */
#include "damper.h"

#include <math.h>
#include <stdio.h>

static unsigned long long seed = 1;

static double uniform(void) {
    seed = seed * 6364136223846793005ULL + 1442695040888963407ULL;
    return (double)(seed >> 11) / 9007199254740992.0;
}

int main(void) {
    static const double odd[] = {0.0, -0.0, 1e-300, -1e-300, 1e300, -1e300, 1e-9, NAN, INFINITY};
    static damper device;
    long codes[6] = {0};
    int i, k, run;
    for (i = 0; i < damper_set_count; i++) {
        damper_state state, saved;
        if (damper_prepare(&device, &damper_sets[i])) return 1;
        for (run = 0; run < 20; run++) {
            double x = 0.0, size = pow(10.0, -4.0 + 5.0 * uniform());
            damper_start(&state, &device, run % 3 - 1);
            for (k = 0; k < 200; k++) {
                double kind = uniform(), dt = pow(10.0, -5.0 + 4.0 * uniform());
                double v = size * (uniform() - 0.5) / dt, p = 4.0 * uniform() - 0.2;
                int code;
                x += kind < 0.1 ? 0.0 : kind < 0.2 ? -x : size * (uniform() - 0.5);
                if (kind > 0.98) dt = odd[(int)(9.0 * uniform())];
                if (kind > 0.96 && kind < 0.98) v = odd[(int)(9.0 * uniform())];
                if (kind > 0.94 && kind < 0.96) p = odd[(int)(9.0 * uniform())];
                saved = state;
                code = damper_step(&state, dt, kind > 0.93 && kind < 0.94 ? 1e300 * v : x, v, p);
                codes[code + 4]++;
                if (code < 0 && (state.force != saved.force || state.work != saved.work ||
                                 state.memory.displacement != saved.memory.displacement))
                    return 2;
                if (!isfinite(state.force)) return 3;
            }
        }
    }
    if (damper_prepare(&device, NULL) != DAMPER_BAD_SET || damper_find("none")) return 4;
    for (k = 0; k < 6; k++) printf("%ld ", codes[k]);
    return 0;
}
