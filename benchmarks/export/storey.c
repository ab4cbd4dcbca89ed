/* Draws of a storey with the exported damper, for run.py: kip, in, s.
 *
 *     storey MASS STIFFNESS DAMPING STEP ACTUATION < accelerations, ended by x
 *
 * Newmark's average acceleration, the damper's force iterated by secants in each step. Prints the
 * largest drift of each set, and the processor time of all, s, and of one step of the damper, µs.
 */
#include "damper.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static double ground[1 << 16];
static long steps;

static double drift(const damper *device, int n, double m, double k, double c, double h, double p) {
    damper_state state, trial;
    double x = 0, v = 0, a = -ground[0], peak = 0, rest, force;
    double stiff = m + 0.5 * h * c + 0.25 * h * h * k;
    int j, i;
    damper_start(&state, device, ground[0] > 0 ? -1 : 1);
    damper_step(&state, 0.0, 0.0, 0.0, p);
    force = rest = state.force;
    for (j = 1; j < n; j++) {
        double low = 0, low_off = 0, next = force, off, x1 = 0, v1 = 0, a1 = 0;
        for (i = 0; i < 60; i++) {
            double load = -m * ground[j] - (next - rest) - c * (v + 0.5 * h * a);
            a1 = (load - k * (x + h * v + 0.25 * h * h * a)) / stiff;
            x1 = x + h * v + 0.25 * h * h * (a + a1);
            v1 = v + 0.5 * h * (a + a1);
            trial = state;
            if (damper_step(&trial, h, x1, v1, p) < 0) return NAN;
            steps++;
            force = trial.force;
            off = force - next;
            if (fabs(off) <= 1e-7 * (1 + fabs(force))) break;
            force = i && off != low_off ? next - off * (next - low) / (off - low_off) : next + 0.5 * off;
            low = next;
            low_off = off;
            next = force;
        }
        state = trial;
        x = x1, v = v1, a = a1;
        peak = fmax(peak, fabs(x));
    }
    return peak;
}

int main(int count, char **word) {
    static damper device;
    double value[5];
    clock_t begin;
    int n = 0, i;
    if (count != 6) return 2;
    for (i = 0; i < 5; i++) value[i] = atof(word[i + 1]);
    while (n < 1 << 16 && scanf("%lf", &ground[n]) == 1) n++;
    begin = clock();
    for (i = 0; i < damper_set_count; i++) {
        if (damper_prepare(&device, &damper_sets[i])) return 1;
        printf("%.9g\n", drift(&device, n, value[0], value[1], value[2], value[3], value[4]));
    }
    printf("%.9g\n", (double)(clock() - begin) / CLOCKS_PER_SEC);
    printf("%ld\n", steps);
    return 0;
}
