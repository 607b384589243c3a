/* Sources of evidence put together (`mount.fusion`).

   Covariances are taken apart as L D L' by elimination without a search for pivots, which symmetric
   positive definite matrices do not need. */

#include "numerics.h"

enum { MOST = 40, MOST_ANGLES = 3 };

/* Eliminate below the diagonal of an (n, n) matrix that is followed by columns, all (n, wide). */
static void eliminate(double *m, Size n, Size wide)
{
    for (Size k = 0; k < n; k++)
        for (Size i = k + 1; i < n; i++) {
            double factor = m[i * wide + k] / m[k * wide + k];
            for (Size j = k; j < wide; j++)
                m[i * wide + j] -= factor * m[k * wide + j];
        }
}

/* Solve an eliminated (n, n) matrix for column c of those that follow it. */
static void substitute(const double *m, Size n, Size wide, Size c, double *out)
{
    for (Size i = n - 1; i >= 0; i--) {
        double sum = m[i * wide + c];
        for (Size j = i + 1; j < n; j++)
            sum -= m[i * wide + j] * out[j];
        out[i] = sum / m[i * wide + i];
    }
}

/* How well S covariances (S, n, n) bear values y (n,) of which angles X (n, A) are free.

   squares: (S,) left' V^-1 left; pivots: (S, n) and of the angles' information (S, A). */
KERNEL long free_of_angles(PyObject *V_, PyObject *X_, PyObject *y_, PyObject *squares_,
                           PyObject *pivots_, PyObject *of_angles_)
{
    Arrays a = {0};
    const double *V = doubles(&a, V_, SHAPE(ANY, ANY, ANY));
    Size scales = length_of(&a, 0), n = length_of(&a, 1);
    int square = n == length_of(&a, 2);
    const double *X = doubles(&a, X_, SHAPE(n, ANY));
    Size angles = length_of(&a, 1);
    const double *y = doubles(&a, y_, SHAPE(n));
    double *squares = doubles_out(&a, squares_, SHAPE(scales));
    double *pivots = doubles_out(&a, pivots_, SHAPE(scales, n));
    double *of_angles = doubles_out(&a, of_angles_, SHAPE(scales, angles));
    if (a.failed)
        return leave(&a, -1);
    if (!square || n > MOST || angles > MOST_ANGLES)
        return leave(&a, refuse(&a, "more sources than are put together"));
    begin();
    Size wide = n + angles + 1, narrow = angles + 1;
    double m[MOST * (MOST + MOST_ANGLES + 1)], J[MOST_ANGLES * (MOST_ANGLES + 1)];
    double found[MOST_ANGLES], product[MOST];
    for (Size s = 0; s < scales; s++) {
        for (Size i = 0; i < n; i++) {
            memcpy(m + i * wide, V + (s * n + i) * n, (size_t)n * sizeof *m);
            memcpy(m + i * wide + n, X + i * angles, (size_t)angles * sizeof *m);
            m[i * wide + n + angles] = y[i];
        }
        eliminate(m, n, wide);
        for (Size p = 0; p < angles; p++)
            for (Size q = 0; q < narrow; q++) {
                double sum = 0.0;
                for (Size i = 0; i < n; i++)
                    sum += m[i * wide + n + p] * m[i * wide + n + q] / m[i * wide + i];
                J[p * narrow + q] = sum;
            }
        eliminate(J, angles, narrow);
        substitute(J, angles, narrow, angles, found);
        for (Size i = 0; i < n; i++) {
            double left = m[i * wide + n + angles];
            for (Size p = 0; p < angles; p++)
                left -= m[i * wide + n + p] * found[p];
            product[i] = left * left / m[i * wide + i];
            pivots[s * n + i] = m[i * wide + i];
        }
        double sum = 0.0;
        for (Size i = 0; i < n; i++)
            sum += product[i];
        squares[s] = sum;
        for (Size p = 0; p < angles; p++)
            of_angles[s * angles + p] = J[p * narrow + p];
    }
    return leave(&a, raised());
}

/* Best means of A angles' sources by S covariances (S, A, n, n), as `fusion._means` has them.

   values: (A, n); used: (A, n) which places hold one. probability: (S,). widest: of the spread of
   sources that disagree. mean, variance: (A,); carried: (A, n) the sources' shares. */
KERNEL long fused_means(PyObject *V_, PyObject *values_, PyObject *used_, PyObject *probability_,
                        double widest, PyObject *mean_, PyObject *variance_, PyObject *carried_)
{
    Arrays a = {0};
    const double *V = doubles(&a, V_, SHAPE(ANY, ANY, ANY, ANY));
    Size scales = length_of(&a, 0), angles = length_of(&a, 1), n = length_of(&a, 2);
    int square = n == length_of(&a, 3);
    const double *values = doubles(&a, values_, SHAPE(angles, n));
    const uint8_t *used = flags_in(&a, used_, SHAPE(angles, n));
    const double *probability = doubles(&a, probability_, SHAPE(scales));
    double *mean = doubles_out(&a, mean_, SHAPE(angles));
    double *variance = doubles_out(&a, variance_, SHAPE(angles));
    double *carried = doubles_out(&a, carried_, SHAPE(angles, n));
    if (a.failed)
        return leave(&a, -1);
    if (!square || n < 1 || n > MOST || scales < 1 || scales > MOST)
        return leave(&a, refuse(&a, "more sources than are put together"));
    begin();
    Size wide = n + 1;
    double m[MOST * (MOST + 1)], solved[MOST], weight[MOST], left[MOST], each[MOST], own[MOST];
    for (Size angle = 0; angle < angles; angle++) {
        const double *x = values + angle * n;
        const uint8_t *is = used + angle * n;
        double count = 0.0;
        for (Size i = 0; i < n; i++) {
            count += is[i] ? 1.0 : 0.0;
            carried[angle * n + i] = 0.0;
        }
        double of = count - 1.0 > 1.0 ? count - 1.0 : 1.0;
        for (Size s = 0; s < scales; s++) {
            const double *C = V + (s * angles + angle) * n * n;
            double total = 0.0, value = 0.0, squares = 0.0, spread = 0.0, even = 0.0;
            for (int pass = 0; pass < 2; pass++) {
                for (Size i = 0; i < n; i++) {
                    memcpy(m + i * wide, C + i * n, (size_t)n * sizeof *m);
                    m[i * wide + n] = pass ? left[i] : 1.0;
                }
                eliminate(m, n, wide);
                substitute(m, n, wide, n, solved);
                if (pass) {
                    for (Size i = 0; i < n; i++)
                        squares += left[i] * solved[i];
                    continue;
                }
                for (Size i = 0; i < n; i++) {
                    weight[i] = larger(solved[i], 0.0) * (is[i] ? 1.0 : 0.0);
                    total += weight[i];
                }
                for (Size i = 0; i < n; i++) {
                    weight[i] /= total;
                    value += weight[i] * x[i];
                    even += weight[i] * weight[i];
                    carried[angle * n + i] += probability[s] * weight[i];
                }
                for (Size i = 0; i < n; i++)
                    left[i] = (x[i] - value) * (is[i] ? 1.0 : 0.0);
            }
            for (Size i = 0; i < n; i++) {
                double sum = 0.0;
                for (Size j = 0; j < n; j++)
                    sum += C[i * n + j] * weight[j];
                spread += weight[i] * sum;
            }
            double apart = larger(squares / of, 1.0);
            apart = isless(widest, apart) ? widest : apart;
            each[s] = value;
            own[s] = spread * (1.0 + (apart - 1.0) * (count / of * (1.0 - even)));
        }
        double sum = 0.0, around = 0.0;
        for (Size s = 0; s < scales; s++)
            sum += probability[s] * each[s];
        for (Size s = 0; s < scales; s++)
            around += probability[s] * (own[s] + (each[s] - sum) * (each[s] - sum));
        mean[angle] = sum;
        variance[angle] = around + (sum - each[0]) * (sum - each[0]);
    }
    return leave(&a, raised());
}
