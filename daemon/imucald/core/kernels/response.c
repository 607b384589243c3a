/* Products of spectra band by band, and the sums that the regressions need of them
   (`mount.evidence_spectra`, `mount.evidence_rows`). */

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
    int fits = first >= 0 && first <= windows - n && pairs >= 0 && starts[0] >= 0 &&
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

/* Power that each row's known response leaves of windows, as `evidence_rows.left_over` has it.

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

/* Scores and normal matrices of windows first .., as `evidence_rows.scores` makes them.

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
    int fits = first >= 0 && first <= windows - n;
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

/* What is left over once each window's own angle is taken off, as `evidence_rows.less_angle` has it.

   left: (ROWS, n, BANDS). pair, sign: (terms,) of the target, sign 0 one, k a gain taken off; starts:
   (ROWS + 1,) by row. power, axis: (ROWS,) of the angle. factor: (ROWS, BANDS). angle: (n, 3). */
KERNEL long less_angle(PyObject *left_, PyObject *P_, PyObject *gains_, PyObject *pair_,
                       PyObject *sign_, PyObject *starts_, PyObject *power_, PyObject *axis_,
                       PyObject *factor_, PyObject *angle_, PyObject *out_)
{
    Arrays a = {0};
    const double *left = doubles(&a, left_, SHAPE(ROWS, ANY, BANDS));
    Size n = length_of(&a, 1);
    const double *P = doubles(&a, P_, SHAPE(ANY, n, BANDS));
    Size pairs = length_of(&a, 0);
    const double *gains = doubles(&a, gains_, SHAPE(GAINS, BANDS));
    const int64_t *pair = take(&a, pair_, 'q', SHAPE(ANY));
    Size terms = length_of(&a, 0);
    const int64_t *sign = take(&a, sign_, 'q', SHAPE(terms));
    const int64_t *starts = take(&a, starts_, 'q', SHAPE(ROWS + 1));
    const int64_t *power = take(&a, power_, 'q', SHAPE(ROWS));
    const int64_t *axis = take(&a, axis_, 'q', SHAPE(ROWS));
    const double *factor = doubles(&a, factor_, SHAPE(ROWS, BANDS));
    const double *angle = doubles(&a, angle_, SHAPE(n, 3));
    double *out = take_out(&a, out_, 'd', SHAPE(ROWS, n, BANDS));
    if (a.failed)
        return leave(&a, -1);
    int fits = starts[0] >= 0 && starts[ROWS] <= terms;
    for (Size row = 0; row < ROWS; row++)
        fits = fits && starts[row] < starts[row + 1] && power[row] >= 0 && power[row] < pairs &&
               axis[row] >= 0 && axis[row] < 3;
    for (Size k = 0; k < terms; k++)
        fits = fits && pair[k] >= 0 && pair[k] < pairs && sign[k] >= 0 && sign[k] <= GAINS;
    if (!fits)
        return leave(&a, refuse(&a, "terms beyond the products"));
    begin();
    for (Size row = 0; row < ROWS; row++)
        for (Size w = 0; w < n; w++)
            for (Size band = 0; band < BANDS; band++) {
                double first = 0.0, others = 0.0;
                for (int64_t k = starts[row]; k < starts[row + 1]; k++) {
                    double term = P[(pair[k] * n + w) * BANDS + band];
                    term *= sign[k] ? -gains[(sign[k] - 1) * BANDS + band] : 1.0;
                    if (k == starts[row])
                        first = term;
                    else
                        others += term;
                }
                double answer = factor[row * BANDS + band] * angle[3 * w + axis[row]];
                double own = answer * P[(power[row] * n + w) * BANDS + band] - 2.0 * (first + others);
                Size at = (row * n + w) * BANDS + band;
                out[at] = larger(left[at] + answer * own, 0.0);
            }
    return leave(&a, raised());
}

/* What windows count for, as `evidence_response._weights` has it. nu: (ROWS,); noise: (ROWS, BANDS). */
KERNEL long window_weights(PyObject *left_, PyObject *nu_, PyObject *noise_, PyObject *dof_,
                           double times, PyObject *out_)
{
    Arrays a = {0};
    const double *left = doubles(&a, left_, SHAPE(ROWS, ANY, BANDS));
    Size n = length_of(&a, 1);
    const double *nu = doubles(&a, nu_, SHAPE(ROWS));
    const double *noise = doubles(&a, noise_, SHAPE(ROWS, BANDS));
    const double *dof = doubles(&a, dof_, SHAPE(BANDS));
    double *out = take_out(&a, out_, 'd', SHAPE(ROWS, n, BANDS));
    if (a.failed)
        return leave(&a, -1);
    begin();
    for (Size row = 0; row < ROWS; row++)
        for (Size w = 0; w < n; w++)
            for (Size band = 0; band < BANDS; band++) {
                Size at = (row * n + w) * BANDS + band;
                out[at] = (nu[row] + dof[band]) /
                          (nu[row] * noise[row * BANDS + band] + times * left[at]);
            }
    return leave(&a, raised());
}

enum Levels { LONE, LEAST_POWER, PER_TICK, TRUST, MEAN_SHARE, UNEVEN, UNEVEN_WINDOWS, NU_MIN, NU_MAX,
              LEVELS };

/* Gains per band, as `evidence_rows.renewed_gains` has them. row, power, cross: (GAINS,) of the
   weights and the products; numbers: (GAINS, 4) scale, expected, least, most. */
KERNEL long renewed_gains(PyObject *P_, PyObject *weight_, PyObject *row_, PyObject *power_,
                          PyObject *cross_, PyObject *numbers_, PyObject *out_)
{
    Arrays a = {0};
    const double *P = doubles(&a, P_, SHAPE(ANY, ANY, BANDS));
    Size pairs = length_of(&a, 0), n = length_of(&a, 1);
    const double *weight = doubles(&a, weight_, SHAPE(ROWS, n, BANDS));
    const int64_t *row = take(&a, row_, 'q', SHAPE(GAINS));
    const int64_t *power = take(&a, power_, 'q', SHAPE(GAINS));
    const int64_t *cross = take(&a, cross_, 'q', SHAPE(GAINS));
    const double *number = doubles(&a, numbers_, SHAPE(GAINS, 4));
    double *out = take_out(&a, out_, 'd', SHAPE(GAINS, BANDS));
    if (a.failed)
        return leave(&a, -1);
    int fits = 1;
    for (Size k = 0; k < GAINS; k++)
        fits = fits && row[k] >= 0 && row[k] < ROWS && power[k] >= 0 && power[k] < pairs &&
               cross[k] >= 0 && cross[k] < pairs;
    if (!fits)
        return leave(&a, refuse(&a, "gains beyond the products"));
    begin();
    for (Size k = 0; k < GAINS; k++)
        for (Size band = 0; band < BANDS; band++) {
            double of_power = 0.0, of_cross = 0.0;
            for (Size w = 0; w < n; w++) {
                double own = weight[(row[k] * n + w) * BANDS + band];
                of_power += own * P[(power[k] * n + w) * BANDS + band];
                of_cross += own * P[(cross[k] * n + w) * BANDS + band];
            }
            of_power += number[4 * k];
            of_cross += number[4 * k] * number[4 * k + 1];
            double gain = larger(of_cross / of_power, number[4 * k + 2]);
            out[k * BANDS + band] = isless(number[4 * k + 3], gain) ? number[4 * k + 3] : gain;
        }
    return leave(&a, raised());
}

/* Noise levels and evenness of windows, as `evidence_response` renews them.

   powers: (ROWS, 2) products whose sum is a window's power, -1 for none. width: (BANDS,) bins. prior,
   floor: (ROWS,). windows: that are kept. noise: (ROWS, BANDS) as it was, and then as it is; nu:
   (ROWS,). */
KERNEL long renew_levels(PyObject *P_, PyObject *weight_, PyObject *left_, PyObject *powers_,
                         PyObject *width_, PyObject *prior_, PyObject *floor_, PyObject *numbers_,
                         double windows, long forces, PyObject *noise_, PyObject *nu_)
{
    Arrays a = {0};
    const double *P = doubles(&a, P_, SHAPE(ANY, ANY, BANDS));
    Size pairs = length_of(&a, 0), n = length_of(&a, 1);
    const double *weight = doubles(&a, weight_, SHAPE(ROWS, n, BANDS));
    const double *left = doubles(&a, left_, SHAPE(ROWS, n, BANDS));
    const int64_t *powers = take(&a, powers_, 'q', SHAPE(ROWS, 2));
    const double *width = doubles(&a, width_, SHAPE(BANDS));
    const double *prior = doubles(&a, prior_, SHAPE(ROWS));
    const double *floors = doubles(&a, floor_, SHAPE(ROWS));
    const double *number = doubles(&a, numbers_, SHAPE(LEVELS));
    double *noise = take_out(&a, noise_, 'd', SHAPE(ROWS, BANDS));
    double *nu = take_out(&a, nu_, 'd', SHAPE(ROWS));
    if (a.failed)
        return leave(&a, -1);
    int fits = n >= 1 && forces >= 0 && forces <= ROWS;
    for (Size k = 0; k < ROWS; k++)
        fits = fits && powers[2 * k] >= 0 && powers[2 * k] < pairs && powers[2 * k + 1] >= -1 &&
               powers[2 * k + 1] < pairs;
    if (!fits)
        return leave(&a, refuse(&a, "levels beyond the products"));
    begin();
    double count = (double)n, all = sum_of(width, BANDS, 1);
    double trust = number[TRUST] / (windows + number[TRUST]);
    trust = 1.0 - trust * trust;
    for (Size row = 0; row < ROWS; row++) {
        double kurtosis[BANDS];
        for (Size band = 0; band < BANDS; band++) {
            double total = 0.0, square = 0.0, weighted = 0.0, even = 0.0, mean = 0.0, fourth = 0.0;
            double was = noise[row * BANDS + band];
            for (Size w = 0; w < n; w++)
                mean += left[(row * n + w) * BANDS + band];
            mean = larger(mean / count, number[LEAST_POWER]);
            for (Size w = 0; w < n; w++) {
                Size at = (row * n + w) * BANDS + band;
                double power = P[(powers[2 * row] * n + w) * BANDS + band];
                if (powers[2 * row + 1] >= 0)
                    power += P[(powers[2 * row + 1] * n + w) * BANDS + band];
                double own = left[at] * (weight[at] * was), size = left[at] / mean;
                fourth += size * size;
                total += power;
                square += power * power;
                weighted += power * own;
                even += own;
            }
            kurtosis[band] = fourth / count / (1.0 + 1.0 / width[band]) * (width[band] / all);
            total = larger(total, number[LEAST_POWER]);
            double shown = total * total / larger(square, number[LEAST_POWER] * number[LEAST_POWER]);
            double level = (shown * (weighted / total) + number[LONE] * (even / count)) /
                           (shown + number[LONE]);
            double fresh = number[PER_TICK] * level / width[band];
            noise[row * BANDS + band] =
                larger(trust * fresh + (1.0 - trust) * prior[row], floors[row]);
        }
        if (row < forces) {
            double *own = noise + row * BANDS;
            own[0] = larger(own[0], number[MEAN_SHARE] * own[1]);
        }
        double excess = (count * sum_of(kurtosis, BANDS, 1) +
                         number[UNEVEN_WINDOWS] * number[UNEVEN]) /
                            (count + number[UNEVEN_WINDOWS]) - 1.0;
        double free = number[NU_MIN] + 2.0 / larger(excess, 0.05);
        nu[row] = isless(number[NU_MAX], free) ? number[NU_MAX] : free;
    }
    return leave(&a, raised());
}
