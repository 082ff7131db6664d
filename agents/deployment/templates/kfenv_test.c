/* Compare the policy in C with kfenv's own, on the vectors in kfenv_golden.h.
 *
 *     cc -std=c99 -O3 kfenv_test.c kfenv_policy.c -lm -o kfenv_test && ./kfenv_test
 *
 * With --bench it tells the time of a step, too.
 */
#include "kfenv_golden.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#ifndef TOLERANCE
#define TOLERANCE 1e-6 /* with KFENV_REAL=float take 1e-4 */
#endif
#define ROUNDS 20

static double largest(const double *got, const double *wanted, int count, int relative)
{
    double most = 0.0;
    for (int i = 0; i < count; i++) {
        const double off = fabs(got[i] - wanted[i]) / (relative ? fabs(wanted[i]) : 1.0);
        most = off > most || isnan(off) ? off : most;
    }
    return most;
}

static void bench(void)
{
    double best = INFINITY, knobs[KFENV_KNOBS];
    for (int round = 0; round < ROUNDS; round++) {
        kfenv_state state;
        const clock_t begin = clock();
        int steps = 0;
        for (int again = 0; again < 1 + 2000 / GOLDEN_STEPS; again++) {
            kfenv_reset(&state);
            for (int i = 0; i < GOLDEN_STEPS; i++, steps++)
                kfenv_step(&state, &golden_instants[i], knobs);
        }
        const double seconds = (double)(clock() - begin) / CLOCKS_PER_SEC / steps;
        best = seconds < best ? seconds : best;
    }
    printf("a step takes %.2f us (best of %d rounds)\n", 1e6 * best, ROUNDS);
}

int main(int argc, char **argv)
{
    double knobs[KFENV_KNOBS], off_knobs = 0.0, off_features = 0.0;
    kfenv_state state;
    kfenv_reset(&state);
    for (int i = 0; i < GOLDEN_STEPS; i++) {
        if (kfenv_step(&state, &golden_instants[i], knobs) != 0) {
            printf("step %d was refused\n", i);
            return 1;
        }
        const double knob = largest(knobs, golden_knobs[i], KFENV_KNOBS, 1);
        const double feature
            = largest(state.observation, golden_observations[i], KFENV_FEATURES, 0);
        off_knobs = knob > off_knobs || isnan(knob) ? knob : off_knobs;
        off_features = feature > off_features || isnan(feature) ? feature : off_features;
    }
    printf("%d steps: knobs at most %.2g off, features %.2g\n", GOLDEN_STEPS, off_knobs,
        off_features);
    if (argc > 1 && strcmp(argv[1], "--bench") == 0)
        bench();
    if (!(off_knobs <= TOLERANCE && off_features <= TOLERANCE)) {
        printf("FAILED: more than %g\n", TOLERANCE);
        return 1;
    }
    return 0;
}
