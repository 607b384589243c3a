/* Products of spectra band by band, and the sums that the regressions need of them
   (`mount.evidence_spectra`, `mount.evidence_scores`). */

#include "numerics.h"

enum { BINS = 52, BANDS = 10, MEASURED = 20, SIGNALS = 22, TERMS = 20, ROWS = 6, GAINS = 7,
       REGRESSORS = 4 };
enum { DVDT = 3, LATERAL = 4, DVDT_QUARTER = 20, LATERAL_QUARTER = 21 };

/* A column of spectra with a delay taken out. */
static inline void shift(double (*re)[SIGNALS], double (*im)[SIGNALS], Size column,
                         const double *phase)
{
    for (Size k = 0; k < BINS; k++) {
        double x = re[k][column], y = im[k][column], c = phase[2 * k], s = phase[2 * k + 1];
        re[k][column] = x * c - y * s;
        im[k][column] = x * s + y * c;
    }
}

/* Products of the signals of a window by band, those that are needed, as `band_products` makes them.

   spectra: (BINS, MEASURED). late: columns that come with the speed's delay. phases: (2, BINS) what
   the delays of speed and yaw rate take. edges: (BANDS + 1,) bins. needed: (P,) of products as
   row * SIGNALS + column. out: (P, windows, BANDS), of which window k is written. */
KERNEL long band_products(PyObject *spectra_, PyObject *late_, PyObject *phases_, PyObject *edges_,
                          PyObject *needed_, long window, PyObject *out_)
{
    Arrays a = {0};
    const double *spectra = take(&a, spectra_, 'D', SHAPE(BINS, MEASURED));
    const int64_t *late = take(&a, late_, 'q', SHAPE(ANY));
    Size columns = length_of(&a, 0);
    const double *phases = take(&a, phases_, 'D', SHAPE(2, BINS));
    const int64_t *edges = take(&a, edges_, 'q', SHAPE(BANDS + 1));
    const int64_t *needed = take(&a, needed_, 'q', SHAPE(ANY));
    Size products = length_of(&a, 0);
    double *out = take_out(&a, out_, 'd', SHAPE(products, ANY, BANDS));
    Size windows = length_of(&a, 1);
    if (a.failed)
        return leave(&a, -1);
    int fits = window >= 0 && window < windows && edges[0] >= 0 && edges[BANDS] <= BINS;
    for (Size k = 0; k < BANDS; k++)
        fits = fits && edges[k] < edges[k + 1];
    for (Size k = 0; k < columns; k++)
        fits = fits && late[k] >= 0 && late[k] < MEASURED;
    for (Size k = 0; k < products; k++)
        fits = fits && needed[k] >= 0 && needed[k] < SIGNALS * SIGNALS;
    if (!fits)
        return leave(&a, refuse(&a, "places beyond those of a window"));
    begin();
    double re[BINS][SIGNALS], im[BINS][SIGNALS];
    for (Size k = 0; k < BINS; k++)
        for (Size c = 0; c < MEASURED; c++) {
            re[k][c] = spectra[2 * (MEASURED * k + c)];
            im[k][c] = spectra[2 * (MEASURED * k + c) + 1];
        }
    for (Size c = 0; c < columns; c++)
        shift(re, im, (Size)late[c], phases);
    shift(re, im, LATERAL, phases + 2 * BINS);
    for (Size k = 0; k < BINS; k++) { /* a quarter period ahead */
        re[k][DVDT_QUARTER] = -im[k][DVDT];
        im[k][DVDT_QUARTER] = re[k][DVDT];
        re[k][LATERAL_QUARTER] = -im[k][LATERAL];
        im[k][LATERAL_QUARTER] = re[k][LATERAL];
    }
    for (Size band = 0; band < BANDS; band++) {
        double sums[SIGNALS][SIGNALS] = {{0}};
        for (Size k = (Size)edges[band]; k < (Size)edges[band + 1]; k++)
            for (int part = 0; part < 2; part++) {
                const double *x = part ? im[k] : re[k];
                for (Size i = 0; i < SIGNALS; i++) {
                    double own = x[i];
                    for (Size j = 0; j < SIGNALS; j++)
                        sums[i][j] += own * x[j];
                }
            }
        for (Size p = 0; p < products; p++)
            out[(p * windows + window) * BANDS + band] = (&sums[0][0])[needed[p]];
    }
    return leave(&a, raised());
}

/* Products of windows first .. stop-1 turned into vehicle axes, as `in_vehicle_axes` makes them.

   products: (P, windows, BANDS). turn: (TERMS, SIGNALS). starts: (pairs + 1,) where each pair's parts
   begin in: column (parts,) of the products, left and right (parts,) places in `turn` whose product
   is the factor. out: (pairs, stop - first, BANDS). */
KERNEL long vehicle_axes(PyObject *products_, PyObject *turn_, PyObject *starts_,
                         PyObject *column_, PyObject *left_, PyObject *right_, long first,
                         PyObject *out_)
{
    Arrays a = {0};
    const double *products = doubles(&a, products_, SHAPE(ANY, ANY, BANDS));
    Size count = length_of(&a, 0), windows = length_of(&a, 1);
    const double *turn = doubles(&a, turn_, SHAPE(TERMS, SIGNALS));
    const int64_t *starts = take(&a, starts_, 'q', SHAPE(ANY));
    Size pairs = length_of(&a, 0) - 1;
    const int64_t *column = take(&a, column_, 'q', SHAPE(ANY));
    Size parts = length_of(&a, 0);
    const int64_t *left = take(&a, left_, 'q', SHAPE(parts));
    const int64_t *right = take(&a, right_, 'q', SHAPE(parts));
    double *out = take_out(&a, out_, 'd', SHAPE(pairs, ANY, BANDS));
    Size n = length_of(&a, 1);
    if (a.failed)
        return leave(&a, -1);
    int fits = first >= 0 && first + n <= windows && pairs >= 0 && starts[0] >= 0 &&
               starts[pairs] <= parts;
    for (Size p = 0; fits && p < pairs; p++)
        fits = starts[p] < starts[p + 1];
    for (Size k = 0; fits && k < parts; k++)
        fits = column[k] >= 0 && column[k] < count && left[k] >= 0 && left[k] < TERMS * SIGNALS &&
               right[k] >= 0 && right[k] < TERMS * SIGNALS;
    if (!fits)
        return leave(&a, refuse(&a, "places beyond those of the products"));
    begin();
    Size each = n * BANDS;
    for (Size p = 0; p < pairs; p++) {
        double *own = out + p * each;
        for (int64_t k = starts[p]; k < starts[p + 1]; k++) {
            const double *of = products + (column[k] * windows + first) * BANDS;
            double factor = turn[left[k]] * turn[right[k]];
            if (k == starts[p])
                for (Size i = 0; i < each; i++)
                    own[i] = factor * of[i];
            else
                for (Size i = 0; i < each; i++)
                    own[i] += factor * of[i];
        }
    }
    return leave(&a, raised());
}

/* A gain's part in a term: 0 is one, k its square, GAINS + k twice it, taken off. */
static inline double factor_of(const double *gains, int64_t code, Size band)
{
    if (!code)
        return 1.0;
    double gain = gains[(code - 1) % GAINS * BANDS + band];
    return code <= GAINS ? gain * gain : -2.0 * gain;
}

/* Power that each row's known response leaves of windows, as `evidence_scores.left_over` has it.

   P: (pairs, n, BANDS). pair, code: (terms,) of what is summed; starts: (ROWS + 1,) by row. */
KERNEL long left_over(PyObject *P_, PyObject *gains_, PyObject *pair_, PyObject *code_,
                      PyObject *starts_, PyObject *out_)
{
    Arrays a = {0};
    const double *P = doubles(&a, P_, SHAPE(ANY, ANY, BANDS));
    Size pairs = length_of(&a, 0), n = length_of(&a, 1);
    const double *gains = doubles(&a, gains_, SHAPE(GAINS, BANDS));
    const int64_t *pair = take(&a, pair_, 'q', SHAPE(ANY));
    Size terms = length_of(&a, 0);
    const int64_t *code = take(&a, code_, 'q', SHAPE(terms));
    const int64_t *starts = take(&a, starts_, 'q', SHAPE(ROWS + 1));
    double *out = take_out(&a, out_, 'd', SHAPE(ROWS, n, BANDS));
    if (a.failed)
        return leave(&a, -1);
    int fits = starts[0] >= 0 && starts[ROWS] <= terms;
    for (Size row = 0; row < ROWS; row++)
        fits = fits && starts[row] < starts[row + 1];
    for (Size k = 0; k < terms; k++)
        fits = fits && pair[k] >= 0 && pair[k] < pairs && code[k] >= 0 && code[k] <= 2 * GAINS;
    if (!fits)
        return leave(&a, refuse(&a, "terms beyond the products"));
    begin();
    for (Size row = 0; row < ROWS; row++)
        for (Size w = 0; w < n; w++)
            for (Size band = 0; band < BANDS; band++) {
                double first = 0.0, others = 0.0;
                for (int64_t k = starts[row]; k < starts[row + 1]; k++) {
                    double term = P[(pair[k] * n + w) * BANDS + band];
                    term *= factor_of(gains, code[k], band);
                    if (k == starts[row])
                        first = term;
                    else
                        others += term;
                }
                out[(row * n + w) * BANDS + band] = larger(first + others, 0.0);
            }
    return leave(&a, raised());
}

enum { RANKS = 3 };

/* Scores and normal matrices of windows first .., as `evidence_scores.scores` makes them.

   P: (pairs, n, BANDS). weight: (ROWS, n, BANDS); used: (ROWS, BANDS). factor: (ROWS, REGRESSORS,
   BANDS). places: (K, 2 + 2 RANKS) row, regressor, then pair and gain of each term, -1 where there is
   none (gain 0: one). entries: (L, 4) row, both regressors, pair. score: (ROWS, windows, REGRESSORS);
   normal: (ROWS, windows, REGRESSORS, REGRESSORS); all else of those windows is zero. */
KERNEL long scores(PyObject *P_, PyObject *weight_, PyObject *used_, PyObject *gains_,
                   PyObject *factor_, PyObject *places_, PyObject *entries_, long first,
                   PyObject *score_, PyObject *normal_)
{
    Arrays a = {0};
    const double *P = doubles(&a, P_, SHAPE(ANY, ANY, BANDS));
    Size pairs = length_of(&a, 0), n = length_of(&a, 1);
    const double *weight = doubles(&a, weight_, SHAPE(ROWS, n, BANDS));
    const double *used = doubles(&a, used_, SHAPE(ROWS, BANDS));
    const double *gains = doubles(&a, gains_, SHAPE(GAINS, BANDS));
    const double *factor = doubles(&a, factor_, SHAPE(ROWS, REGRESSORS, BANDS));
    const int64_t *places = take(&a, places_, 'q', SHAPE(ANY, 2 + 2 * RANKS));
    Size count = length_of(&a, 0);
    const int64_t *entries = take(&a, entries_, 'q', SHAPE(ANY, 4));
    Size matrix = length_of(&a, 0);
    double *score = take_out(&a, score_, 'd', SHAPE(ROWS, ANY, REGRESSORS));
    Size windows = length_of(&a, 1);
    double *normal = take_out(&a, normal_, 'd', SHAPE(ROWS, windows, REGRESSORS, REGRESSORS));
    if (a.failed)
        return leave(&a, -1);
    int fits = first >= 0 && first + n <= windows;
    for (Size k = 0; k < count; k++) {
        const int64_t *at = places + k * (2 + 2 * RANKS);
        fits = fits && at[0] >= 0 && at[0] < ROWS && at[1] >= 0 && at[1] < REGRESSORS && at[2] >= 0;
        for (int rank = 0; rank < RANKS; rank++)
            fits = fits && at[2 + 2 * rank] >= -1 && at[2 + 2 * rank] < pairs &&
                   at[3 + 2 * rank] >= 0 && at[3 + 2 * rank] <= GAINS;
    }
    for (Size k = 0; k < matrix; k++) {
        const int64_t *at = entries + 4 * k;
        fits = fits && at[0] >= 0 && at[0] < ROWS && at[1] >= 0 && at[1] < REGRESSORS &&
               at[2] >= 0 && at[2] < REGRESSORS && at[3] >= 0 && at[3] < pairs;
    }
    if (!fits)
        return leave(&a, refuse(&a, "places beyond those of the scores"));
    begin();
    for (Size row = 0; row < ROWS; row++) {
        Size at = row * windows + first, wide = REGRESSORS * REGRESSORS;
        memset(score + at * REGRESSORS, 0, (size_t)(n * REGRESSORS) * sizeof *score);
        memset(normal + at * wide, 0, (size_t)(n * wide) * sizeof *normal);
    }
    for (Size k = 0; k < count; k++) {
        const int64_t *at = places + k * (2 + 2 * RANKS);
        for (Size w = 0; w < n; w++) {
            double parts[BANDS];
            for (Size band = 0; band < BANDS; band++) {
                double term[RANKS] = {0};
                for (int rank = 0; rank < RANKS && at[2 + 2 * rank] >= 0; rank++) {
                    int64_t gain = at[3 + 2 * rank];
                    double sign = gain ? -gains[(gain - 1) * BANDS + band] : 1.0;
                    term[rank] = P[(at[2 + 2 * rank] * n + w) * BANDS + band] * sign;
                }
                double target = term[0];
                if (at[6] >= 0)
                    term[1] += term[2];
                if (at[4] >= 0)
                    target += term[1];
                target *= weight[(at[0] * n + w) * BANDS + band] * used[at[0] * BANDS + band];
                parts[band] = target * factor[(at[0] * REGRESSORS + at[1]) * BANDS + band];
            }
            score[(at[0] * windows + first + w) * REGRESSORS + at[1]] = sum_of(parts, BANDS, 1);
        }
    }
    for (Size k = 0; k < matrix; k++) {
        const int64_t *at = entries + 4 * k;
        const double *one = factor + (at[0] * REGRESSORS + at[1]) * BANDS;
        const double *other = factor + (at[0] * REGRESSORS + at[2]) * BANDS;
        for (Size w = 0; w < n; w++) {
            double parts[BANDS];
            for (Size band = 0; band < BANDS; band++)
                parts[band] = P[(at[3] * n + w) * BANDS + band] *
                              (weight[(at[0] * n + w) * BANDS + band] * used[at[0] * BANDS + band]) *
                              (one[band] * other[band]);
            double sum = sum_of(parts, BANDS, 1);
            double *own = normal + (at[0] * windows + first + w) * REGRESSORS * REGRESSORS;
            own[at[1] * REGRESSORS + at[2]] = sum;
            own[at[2] * REGRESSORS + at[1]] = sum;
        }
    }
    return leave(&a, raised());
}
