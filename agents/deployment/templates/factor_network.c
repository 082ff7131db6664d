/* From the observation to the logarithms of the factors, and to the action that sets them.
 *
 * One network looks at each set of features, with a memory for each; what is asked of a knob
 * more than once counts in the mean.
 */

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

static void ask(kfenv_state *state, int set, real logs[ASKED])
{
    real z[SEEN], x[KEPT + HIDDEN], y[HIDDEN];
    for (int i = 0; i < SEEN; i++) {
        z[i] = (real)((state->observation[seen_by[set][i]] - mean[i]) / deviation[i]);
        z[i] = z[i] > CUT ? CUT : z[i] < -CUT ? -CUT : z[i];
    }
    affine(z, SEEN, weight_in, bias_in, HIDDEN, x + KEPT);
    squash(x + KEPT, HIDDEN);
#if KFENV_MEMORY
    double *memory = state->memory + set * KEPT;
    for (int i = 0; i < KEPT; i++)
        x[i] = (real)memory[i];
    recur(x + KEPT, x);
    for (int i = 0; i < KEPT; i++)
        memory[i] = x[i];
#endif
    affine(x, KEPT + HIDDEN, weight_mid, bias_mid, HIDDEN, y);
    squash(y, HIDDEN);
    affine(y, HIDDEN, weight_out, bias_out, ASKED, logs);
    for (int j = 0; j < ASKED; j++)
        logs[j] = logs[j] > most[j] ? most[j] : logs[j] < least[j] ? least[j] : logs[j];
}

static void decide(kfenv_state *state)
{
    double wanted[KFENV_KNOBS] = {0.0};
    real logs[ASKED];
    for (int set = 0; set < SETS; set++) {
        ask(state, set, logs);
        for (int j = 0; j < ASKED; j++)
            wanted[set_by[set][j]] += logs[j] / askers[set_by[set][j]];
    }
    for (int k = 0; k < KFENV_KNOBS; k++)
        state->action[k] = wanted[k] >= 0.0 ? wanted[k] / knob_high[k] : wanted[k] / -knob_low[k];
}
