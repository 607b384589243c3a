/* Evidence road segment by road segment (`mount.road_segments`, `mount.shift`). */

#include "numerics.h"

enum { K = 4 };

/* The inverse of a symmetric positive definite matrix, which needs no search for pivots. */
static void invert(const double *of, double *out)
{
    memcpy(out, of, K * K * sizeof *out);
    for (int k = 0; k < K; k++) {
        double pivot = 1.0 / out[K * k + k];
        for (int j = 0; j < K; j++)
            if (j != k)
                out[K * k + j] *= pivot;
        for (int i = 0; i < K; i++) {
            double own = out[K * i + k];
            if (i == k)
                continue;
            for (int j = 0; j < K; j++)
                if (j != k)
                    out[K * i + j] -= own * out[K * k + j];
            out[K * i + k] = -(own * pivot);
        }
        out[K * k + k] = pivot;
    }
}

/* The fits of rows over G segments, as `road_segments.fit_regressions` makes them.

   score: (R, G, K), normal: (R, G, K, K), of which rows `use` (U,) are fitted. total, priors: (U, K, K)
   information of all segments, and of the priors; inverse: (U, K, K) of both. value: (U, K). left, u, own, flow: (U, G). sums: (U, 3) of u u, of u and the next, of the
   square of what each segment knows. */
KERNEL long fit_segments(PyObject *score_, PyObject *normal_, PyObject *use_, PyObject *total_,
                         PyObject *priors_, PyObject *inverse_, PyObject *value_, PyObject *left_, PyObject *u_,
                         PyObject *own_, PyObject *flow_, PyObject *sums_)
{
    Arrays a = {0};
    const double *score = doubles(&a, score_, SHAPE(ANY, ANY, K));
    Size rows = length_of(&a, 0), n = length_of(&a, 1);
    const double *normal = doubles(&a, normal_, SHAPE(rows, n, K, K));
    const int64_t *use = take(&a, use_, 'q', SHAPE(ANY));
    Size used = length_of(&a, 0);
    const double *total = doubles(&a, total_, SHAPE(used, K, K));
    const double *priors = doubles(&a, priors_, SHAPE(used, K, K));
    double *inverse = doubles_out(&a, inverse_, SHAPE(used, K, K));
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
        double *P = inverse + k * K * K, information[K * K];
        for (int i = 0; i < K * K; i++)
            information[i] = total[k * K * K + i] + priors[k * K * K + i];
        invert(information, P);
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

enum Change { MIN_KNOWN, CLIP, PRIOR_SEGMENTS, PRIOR_SPREAD, MIN_SPREAD, LEAST, CHANGE };
enum { SCRATCH = 4 };

/* Changes of sources over their last spans, as `shift._changes_of` has them.

   left: (sources, G), rows: (sources, G, K), inverse: (sources, K, K); spans: (S,), none longer than
   G - 1. scratch: (SCRATCH, G) room. size, known: (sources, S). */
KERNEL long span_changes(PyObject *left_, PyObject *rows_, PyObject *inverse_, PyObject *spans_,
                         PyObject *numbers_, PyObject *scratch_, PyObject *size_, PyObject *known_)
{
    Arrays a = {0};
    const double *left = doubles(&a, left_, SHAPE(ANY, ANY));
    Size sources = length_of(&a, 0), n = length_of(&a, 1);
    const double *rows = doubles(&a, rows_, SHAPE(sources, n, K));
    const double *inverse = doubles(&a, inverse_, SHAPE(sources, K, K));
    const int64_t *spans = take(&a, spans_, 'q', SHAPE(ANY));
    Size count = length_of(&a, 0);
    const double *number = doubles(&a, numbers_, SHAPE(CHANGE));
    double *scratch = doubles_out(&a, scratch_, SHAPE(SCRATCH, n));
    double *size = doubles_out(&a, size_, SHAPE(sources, count));
    double *known = doubles_out(&a, known_, SHAPE(sources, count));
    if (a.failed)
        return leave(&a, -1);
    Size longest = 0;
    int fits = 1;
    for (Size s = 0; s < count; s++) {
        fits = fits && spans[s] >= 1 && spans[s] < n;
        longest = spans[s] > longest ? (Size)spans[s] : longest;
    }
    if (!fits)
        return leave(&a, refuse(&a, "spans beyond the segments"));
    begin();
    double *alone = scratch, *expected = scratch + n, *square = scratch + 2 * n, *term = scratch + 3 * n;
    for (Size k = 0; k < sources; k++) {
        const double *u = left + k * n, *row = rows + k * n * K, *P = inverse + k * K * K;
        double all = sum_of(row, n, K);
        for (Size g = 0; g < n; g++) {
            const double *x = row + g * K;
            double fitted = 0.0;
            for (int j = 0; j < K; j++)
                fitted += (x[0] * P[j] + x[1] * P[K + j] + x[2] * P[2 * K + j] + x[3] * P[3 * K + j]) *
                          x[j];
            expected[g] = larger(x[0] - fitted, 0.0);
            square[g] = x[0] * x[0];
        }
        for (Size s = 0; s < count; s++) {
            Size span = (Size)spans[s], old = n - span, at = k * count + s;
            double w[K] = {0}, change = 0.0, turned[K], own = 0.0;
            for (Size g = n - 1; g >= old; g--) {
                for (int j = 0; j < K; j++)
                    w[j] += row[g * K + j];
                change += u[g];
            }
            for (int j = 0; j < K; j++)
                turned[j] = w[0] * P[j] + w[1] * P[K + j] + w[2] * P[2 * K + j] + w[3] * P[3 * K + j];
            for (int j = 0; j < K; j++)
                own += turned[j] * w[j];
            own = w[0] - own;
            int use = isgreater(own, number[MIN_KNOWN] * all);
            own = use ? own : 0.0;
            double moved = change / (use ? own : 1.0) * (use ? 1.0 : 0.0);
            for (Size g = 0; g < n; g++) {
                const double *x = row + g * K;
                alone[g] = u[g] + moved * (turned[0] * x[0] + turned[1] * x[1] + turned[2] * x[2] +
                                           turned[3] * x[3]);
            }
            /* sums over the old segments, the others as zeros among them */
            double sums[4];
            for (Size g = 0; g < n; g++)
                term[g] = (g < old ? 1.0 : 0.0) * alone[g] * alone[g];
            sums[0] = sum_of(term, n, 1);
            for (Size g = 0; g < n; g++)
                term[g] = (g < old ? 1.0 : 0.0) * expected[g];
            sums[1] = sum_of(term, n, 1);
            for (Size g = 0; g < n; g++)
                term[g] = (g < old ? 1.0 : 0.0) * row[g * K];
            sums[2] = sum_of(term, n, 1);
            for (Size g = 0; g < n; g++)
                term[g] = (g < old ? 1.0 : 0.0) * square[g];
            sums[3] = sum_of(term, n, 1);
            double ratio = sums[0] / larger(sums[1], number[LEAST]);
            double segments = sums[2] * sums[2] / larger(sums[3], number[LEAST]);
            double scale = (number[PRIOR_SEGMENTS] * number[PRIOR_SPREAD] +
                            segments * larger(ratio, number[MIN_SPREAD])) /
                           (number[PRIOR_SEGMENTS] + segments);
            for (Size g = n - longest; g < n; g++) {
                double limit = number[CLIP] * sqrt(scale * row[g * K]);
                double held = larger(alone[g], -limit);
                held = isless(limit, held) ? limit : held;
                term[g] = (g < old ? 0.0 : 1.0) * held;
            }
            double held = sum_of(term + n - longest, longest, 1);
            size[at] = held / larger(w[0], number[LEAST]) * (use ? 1.0 : 0.0);
            known[at] = own / scale;
        }
    }
    return leave(&a, raised());
}
