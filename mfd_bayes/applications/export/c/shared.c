/* What a program that loads damper.c as a shared library needs: sizes, and a whole motion. */
#include "damper.h"

#include <stddef.h>

size_t damper_size(void) { return sizeof(damper); }
size_t damper_state_size(void) { return sizeof(damper_state); }

/* Forces along a motion of n samples, dt[0] being without effect; the first code below 0. */
int damper_motion(const damper *device, int direction, int n, const double *dt,
                  const double *displacement, const double *velocity, const double *actuation,
                  double *force) {
    damper_state state;
    int i, code = damper_start(&state, device, direction);
    for (i = 0; i < n && code >= 0; i++) {
        code = damper_step(&state, dt[i], displacement[i], velocity[i], actuation[i]);
        force[i] = state.force;
    }
    return code;
}
