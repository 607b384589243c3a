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

/* Products of rows (n, m), each with each: (n, n). */
static void products(const double *rows, Size n, Size m, double *out)
{
    for (Size i = 0; i < n; i++)
        for (Size j = 0; j < n; j++) {
            double sum = 0.0;
            for (Size k = 0; k < m; k++)
                sum += rows[i * m + k] * rows[j * m + k];
            out[i * n + j] = sum;
        }
}

/* How well covariances bear values y (n,) of which angles X (n, A) are free.

   The covariances are known (n, n) and, for each of scales2 (S,), so many times more as answers (n, m)
   make. squares: (S,) left' V^-1 left; pivots: (S, n) and of the angles' information (S, A). */
KERNEL long free_of_angles(PyObject *known_, PyObject *answers_, PyObject *scales2_, PyObject *X_,
                           PyObject *y_, PyObject *squares_, PyObject *pivots_,
                           PyObject *of_angles_)
{
    Arrays a = {0};
    const double *known = doubles(&a, known_, SHAPE(ANY, ANY));
    Size n = length_of(&a, 0);
    int square = n == length_of(&a, 1);
    const double *answers = doubles(&a, answers_, SHAPE(n, ANY));
    Size terms = length_of(&a, 1);
    const double *scales2 = doubles(&a, scales2_, SHAPE(ANY));
    Size scales = length_of(&a, 0);
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
    double found[MOST_ANGLES], product[MOST], scaled[MOST * MOST];
    products(answers, n, terms, scaled);
    for (Size s = 0; s < scales; s++) {
        for (Size i = 0; i < n; i++) {
            for (Size j = 0; j < n; j++)
                m[i * wide + j] = known[i * n + j] + scales2[s] * scaled[i * n + j];
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

/* Best means of A angles' sources, as `fusion._means` has them.

   known, answers, scales2: the covariances of N sources, as for `free_of_angles`; values: (N,).
   of_angle, used: (A, n) places of each angle's sources, and which of those hold one. probability:
   (S,). widest: of the spread of sources that disagree. mean, variance: (A,); carried: (A, n) the
   sources' shares. */
KERNEL long fused_means(PyObject *known_, PyObject *answers_, PyObject *scales2_, PyObject *values_,
                        PyObject *of_angle_, PyObject *used_, PyObject *probability_, double widest,
                        PyObject *mean_, PyObject *variance_, PyObject *carried_)
{
    Arrays a = {0};
    const double *known = doubles(&a, known_, SHAPE(ANY, ANY));
    Size sources = length_of(&a, 0);
    int square = sources == length_of(&a, 1);
    const double *answers = doubles(&a, answers_, SHAPE(sources, ANY));
    Size terms = length_of(&a, 1);
    const double *scales2 = doubles(&a, scales2_, SHAPE(ANY));
    Size scales = length_of(&a, 0);
    const double *values = doubles(&a, values_, SHAPE(sources));
    const int64_t *of_angle = take(&a, of_angle_, 'q', SHAPE(ANY, ANY));
    Size angles = length_of(&a, 0), n = length_of(&a, 1);
    const uint8_t *used = flags_in(&a, used_, SHAPE(angles, n));
    const double *probability = doubles(&a, probability_, SHAPE(scales));
    double *mean = doubles_out(&a, mean_, SHAPE(angles));
    double *variance = doubles_out(&a, variance_, SHAPE(angles));
    double *carried = doubles_out(&a, carried_, SHAPE(angles, n));
    if (a.failed)
        return leave(&a, -1);
    int fits = square && sources <= MOST && n >= 1 && n <= MOST && scales >= 1 && scales <= MOST;
    for (Size k = 0; fits && k < angles * n; k++)
        fits = of_angle[k] >= 0 && of_angle[k] < sources;
    if (!fits)
        return leave(&a, refuse(&a, "more sources than are put together"));
    begin();
    Size wide = n + 1;
    double scaled[MOST * MOST], C[MOST * MOST], x[MOST];
    products(answers, sources, terms, scaled);
    double m[MOST * (MOST + 1)], solved[MOST], weight[MOST], left[MOST], each[MOST], own[MOST];
    for (Size angle = 0; angle < angles; angle++) {
        const int64_t *at = of_angle + angle * n;
        const uint8_t *is = used + angle * n;
        double count = 0.0;
        for (Size i = 0; i < n; i++) {
            x[i] = values[at[i]];
            count += is[i] ? 1.0 : 0.0;
            carried[angle * n + i] = 0.0;
        }
        double of = count - 1.0 > 1.0 ? count - 1.0 : 1.0;
        for (Size s = 0; s < scales; s++) {
            for (Size i = 0; i < n; i++)
                for (Size j = 0; j < n; j++) { /* an unused place stands alone */
                    Size place = (Size)at[i] * sources + (Size)at[j];
                    C[i * n + j] = is[i] && is[j] ? known[place] + scales2[s] * scaled[place] : i == j;
                }
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
