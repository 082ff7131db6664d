/* From the observation to the logarithms of the factors, and to the action that sets them. */

static void squash(real *x, int count)
{
    for (int i = 0; i < count; i++)
        x[i] = (real)(1.0 - 2.0 / (exp(2.0 * x[i]) + 1.0));
}

#if KFENV_MEMORY
/* A gated recurrent unit: gates in the order reset, keep, new. */
static void recur(const real *x, real *memory)
{
    real fresh[3 * HIDDEN], old[3 * HIDDEN], candidate[HIDDEN];
    affine(x, HIDDEN, weight_ih, bias_ih, 3 * HIDDEN, fresh);
    affine(memory, HIDDEN, weight_hh, bias_hh, 3 * HIDDEN, old);
    for (int i = 0; i < 2 * HIDDEN; i++)
        fresh[i] = (real)(1.0 / (1.0 + exp(-fresh[i] - old[i])));
    for (int i = 0; i < HIDDEN; i++)
        candidate[i] = fresh[2 * HIDDEN + i] + fresh[i] * old[2 * HIDDEN + i];
    squash(candidate, HIDDEN);
    for (int i = 0; i < HIDDEN; i++)
        memory[i] = candidate[i] + fresh[HIDDEN + i] * (memory[i] - candidate[i]);
}
#endif

static void decide(kfenv_state *state)
{
    real z[KFENV_FEATURES], x[KFENV_MEMORY + HIDDEN], y[HIDDEN], logs[KFENV_KNOBS];
    real *first = x + KFENV_MEMORY;
    for (int i = 0; i < KFENV_FEATURES; i++) {
        z[i] = (real)((state->observation[i] - mean[i]) / deviation[i]);
        z[i] = z[i] > CUT ? CUT : z[i] < -CUT ? -CUT : z[i];
    }
    affine(z, KFENV_FEATURES, weight_in, bias_in, HIDDEN, first);
    squash(first, HIDDEN);
#if KFENV_MEMORY
    for (int i = 0; i < HIDDEN; i++)
        x[i] = (real)state->memory[i];
    recur(first, x);
    for (int i = 0; i < HIDDEN; i++)
        state->memory[i] = x[i];
#endif
    affine(x, KFENV_MEMORY + HIDDEN, weight_mid, bias_mid, HIDDEN, y);
    squash(y, HIDDEN);
    affine(y, HIDDEN, weight_out, bias_out, KFENV_KNOBS, logs);
    for (int k = 0; k < KFENV_KNOBS; k++) {
        double value = logs[k];
        value = value > most[k] ? most[k] : value < least[k] ? least[k] : value;
        state->action[k] = value >= 0.0 ? value / knob_high[k] : value / -knob_low[k];
    }
}
