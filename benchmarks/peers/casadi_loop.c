/* A loop over samples around CasADi's C code: one sample a call. */
int entries(const double **argument, double **result, long long *iw, double *w, int memory);

void many(const double *x, double *y, int samples, int joints, int outputs)
{
    for (int k = 0; k < samples; k++, x += 3 * joints, y += outputs) {
        const double *argument[3] = {x, x + joints, x + 2 * joints};
        double *result[1] = {y};
        entries(argument, result, 0, 0, 0);
    }
}
