/* Evidence road segment by road segment (`mount.road_segments`, `mount.shift`). */

#include "numerics.h"

enum { K = 4 };

/* The fits of rows over G segments, as `road_segments.fit_regressions` makes them of inverse.

   score: (R, G, K), normal: (R, G, K, K), of which rows `use` (U,) are fitted. total: (U, K, K), inverse:
   (U, K, K). value: (U, K). left, u, own, flow: (U, G). sums: (U, 3) of u u, of u and the next, of the
   square of what each segment knows. */
KERNEL long fit_segments(PyObject *score_, PyObject *normal_, PyObject *use_, PyObject *total_,
                         PyObject *inverse_, PyObject *value_, PyObject *left_, PyObject *u_,
                         PyObject *own_, PyObject *flow_, PyObject *sums_)
{
    Arrays a = {0};
    const double *score = doubles(&a, score_, SHAPE(ANY, ANY, K));
    Size rows = length_of(&a, 0), n = length_of(&a, 1);
    const double *normal = doubles(&a, normal_, SHAPE(rows, n, K, K));
    const int64_t *use = take(&a, use_, 'q', SHAPE(ANY));
    Size used = length_of(&a, 0);
    const double *total = doubles(&a, total_, SHAPE(used, K, K));
    const double *inverse = doubles(&a, inverse_, SHAPE(used, K, K));
    double *value = doubles_out(&a, value_, SHAPE(used, K));
    double *left = doubles_out(&a, left_, SHAPE(used, n));
    double *u = doubles_out(&a, u_, SHAPE(used, n));
    double *own = doubles_out(&a, own_, SHAPE(used, n));
    double *flow = doubles_out(&a, flow_, SHAPE(used, n));
    double *sums = doubles_out(&a, sums_, SHAPE(used, 3));
    if (a.failed)
        return leave(&a, -1);
    int fits = n >= 1;
    for (Size k = 0; k < used; k++)
        fits = fits && use[k] >= 0 && use[k] < rows;
    if (!fits)
        return leave(&a, refuse(&a, "rows beyond those of the regressions"));
    begin();
    for (Size k = 0; k < used; k++) {
        const double *s = score + use[k] * n * K, *m = normal + use[k] * n * K * K;
        const double *P = inverse + k * K * K;
        double *v = value + k * K, whole[K] = {0};
        for (Size g = 0; g < n; g++)
            for (int i = 0; i < K; i++)
                whole[i] += s[g * K + i];
        for (int i = 0; i < K; i++)
            v[i] = P[K * i] * whole[0] + P[K * i + 1] * whole[1] + P[K * i + 2] * whole[2] +
                   P[K * i + 3] * whole[3];
        double known = total[k * K * K], model = P[0], part = 1.0 / (known * model);
        double *of = flow + k * n; /* first what each knows, squared; then u and the next */
        for (Size g = 0; g < n; g++) {
            double rest[K];
            for (int i = 0; i < K; i++) {
                const double *row = m + (g * K + i) * K;
                rest[i] = s[g * K + i] - (row[0] * v[0] + row[1] * v[1] + row[2] * v[2] + row[3] * v[3]);
            }
            left[k * n + g] = rest[0];
            u[k * n + g] = rest[0] * P[0] + rest[1] * P[1] + rest[2] * P[2] + rest[3] * P[3];
            of[g] = m[g * K * K] * m[g * K * K];
        }
        sums[3 * k + 2] = sum_of(of, n, 1);
        for (Size g = 0; g < n; g++)
            of[g] = u[k * n + g] * u[k * n + g];
        sums[3 * k] = sum_of(of, n, 1);
        for (Size g = 0; g + 1 < n; g++)
            of[g] = u[k * n + g + 1] * u[k * n + g];
        sums[3 * k + 1] = sum_of(of, n - 1, 1);
        for (Size g = 0; g < n; g++) {
            own[k * n + g] = m[g * K * K] * part;
            of[g] = u[k * n + g] / model + own[k * n + g] * v[0];
        }
    }
    return leave(&a, raised());
}
