/* A multilayer perceptron from the observation to the action. */

static real hidden(real x)
{
    return @ACTIVATION@;
}

static void decide(kfenv_state *state)
{
    real one[WIDEST], other[WIDEST];
    real *x = one, *y = other;
    for (int i = 0; i < KFENV_FEATURES; i++)
        x[i] = (real)state->observation[i];
    for (int l = 0; l < COUNT(layers); l++) {
        real *former = x;
        affine(x, layers[l].inputs, layers[l].weight, layers[l].bias, layers[l].outputs, y);
        if (l + 1 < COUNT(layers))
            for (int i = 0; i < layers[l].outputs; i++)
                y[i] = hidden(y[i]);
        x = y;
        y = former;
    }
    for (int k = 0; k < KFENV_KNOBS; k++)
        state->action[k] = @OUTPUT@;
}
