/* Samples of the sensors: what the ticks, and the hops of their health, come to. */

#include "arrays.h"

enum { MOST_WIDTH = 3 };
#define MOST_TICKS 4503599627370496.0 /* whole numbers of doubles are exact up to there */

enum Columns { COUNT, MEAN, SQUARE, LEAST, MOST, AGE, LAST, COLUMNS };
enum { NONE = -1 };

/* Sums over the samples of each tick, as `column_ticks` makes them.

   out: (ticks, W) rows of ticks, the first of number `first`; each ends at out[k][0]. values: (N, k)
   of any strides. columns: where the count goes, the first mean, ..., the last value, -1 where it is
   not wanted. Times never decrease; 1 where they do, and nothing has been written. */
KERNEL long tick_sums(PyObject *t_, PyObject *values_, PyObject *columns_, long first, double rate,
                      PyObject *out_)
{
    Arrays a = {0};
    const double *t = doubles(&a, t_, SHAPE(ANY));
    Size n = length_of(&a, 0);
    const Py_buffer *values = take_view(&a, values_, 'd', SHAPE(n, ANY), STRIDES);
    Size width = length_of(&a, 1);
    const int64_t *columns = take(&a, columns_, 'q', SHAPE(COLUMNS));
    double *out = doubles_out(&a, out_, SHAPE(ANY, ANY));
    Size ticks = length_of(&a, 0), row = length_of(&a, 1);
    if (a.failed)
        return leave(&a, -1);
    int fits = width >= 1 && width <= MOST_WIDTH && fabs((double)first) <= MOST_TICKS;
    for (int k = 0; k < COLUMNS; k++) {
        Size most = k == COUNT || k == AGE || k == LAST ? 1 : width;
        fits = fits && columns[k] >= NONE && columns[k] <= row - most;
    }
    if (!fits)
        return leave(&a, refuse(&a, "columns beyond those of a tick"));
    for (Size i = 1; i < n; i++)
        if (!(t[i] >= t[i - 1]))
            return leave(&a, 1);
    const char *base = values->buf;
    Size down = values->strides[0], across = values->strides[1];
    for (Size i = 0; i < n;) {
        double place = floor(t[i] * rate);
        if (!(place >= (double)first && place < (double)first + (double)ticks)) {
            i++;
            continue;
        }
        Size begun = i;
        double time = 0.0;
        for (; i < n && t[i] * rate < place + 1.0; i++)
            time += t[i];
        double *tick = out + (Size)(place - (double)first) * row, samples = (double)(i - begun);
        if (columns[COUNT] >= 0)
            tick[columns[COUNT]] = samples;
        for (Size k = 0; k < width; k++) {
            const char *own = base + k * across;
            double sum = 0.0, square = 0.0, least = INFINITY, most = -INFINITY;
            for (Size at = begun; at < i; at++)
                sum += *(const double *)(own + at * down);
            if (columns[MEAN] >= 0)
                tick[columns[MEAN] + k] = sum / samples;
            if (columns[SQUARE] < 0 && columns[LEAST] < 0 && columns[MOST] < 0)
                continue;
            for (Size at = begun; at < i; at++) {
                double x = *(const double *)(own + at * down);
                square += x * x;
                least = x < least ? x : least;
                most = x > most ? x : most;
            }
            if (columns[SQUARE] >= 0)
                tick[columns[SQUARE] + k] = square / samples;
            if (columns[LEAST] >= 0)
                tick[columns[LEAST] + k] = least;
            if (columns[MOST] >= 0)
                tick[columns[MOST] + k] = most;
        }
        if (columns[LAST] >= 0)
            tick[columns[LAST]] = *(const double *)(base + (i - 1) * down);
        if (columns[AGE] >= 0)
            tick[columns[AGE]] = tick[0] - time / samples;
    }
    return leave(&a, 0);
}

/* The figures of hops, axis by axis, as `hops.hop_rows` makes them.

   samples: (axes, N). edges: (H + 1,) where each hop begins. last, run, step: (axes,) as in `Carry`;
   they are brought up to the end. mean .. on_top: by axis and hop, extremes by side, too. */
KERNEL long hop_figures(PyObject *samples_, PyObject *edges_, PyObject *last_, PyObject *run_,
                        PyObject *step_, PyObject *mean_, PyObject *level_, PyObject *steps_,
                        PyObject *ended_, PyObject *longest_, PyObject *runs_, PyObject *top_,
                        PyObject *on_top_)
{
    Arrays a = {0};
    const double *samples = doubles(&a, samples_, SHAPE(ANY, ANY));
    Size axes = length_of(&a, 0), n = length_of(&a, 1);
    const int64_t *edges = take(&a, edges_, 'q', SHAPE(ANY));
    Size hops = length_of(&a, 0) - 1;
    double *last = doubles_out(&a, last_, SHAPE(axes));
    int64_t *run = take_out(&a, run_, 'q', SHAPE(axes));
    double *step = doubles_out(&a, step_, SHAPE(axes));
    double *mean = doubles_out(&a, mean_, SHAPE(axes, hops));
    double *level = doubles_out(&a, level_, SHAPE(axes, hops));
    double *steps = doubles_out(&a, steps_, SHAPE(axes, hops));
    int64_t *ended = take_out(&a, ended_, 'q', SHAPE(axes, hops));
    int64_t *longest = take_out(&a, longest_, 'q', SHAPE(axes, hops));
    int64_t *runs = take_out(&a, runs_, 'q', SHAPE(axes, hops));
    double *top = doubles_out(&a, top_, SHAPE(2, axes, hops));
    int64_t *on_top = take_out(&a, on_top_, 'q', SHAPE(2, axes, hops));
    if (a.failed)
        return leave(&a, -1);
    int fits = hops >= 0 && edges[0] >= 0 && edges[hops] <= n;
    for (Size axis = 0; axis < axes; axis++)
        fits = fits && run[axis] >= 0 && run[axis] <= LARGEST_COUNT;
    for (Size h = 0; fits && h < hops; h++)
        fits = edges[h] <= edges[h + 1];
    if (!fits)
        return leave(&a, refuse(&a, "hops beyond their samples"));
    for (Size axis = 0; axis < axes; axis++) {
        const double *own = samples + axis * n;
        double before = last[axis], least = step[axis];
        int64_t equal = run[axis];
        for (Size h = 0; h < hops; h++) {
            double sum = 0.0, change = 0.0, high = -INFINITY, low = INFINITY;
            int64_t over = 0, most = 0, on_high = 0, on_low = 0;
            for (Size i = edges[h]; i < edges[h + 1]; i++) {
                double x = own[i];
                sum += x;
                if (x > high) {
                    high = x;
                    on_high = 1;
                } else if (x == high)
                    on_high++;
                if (x < low) {
                    low = x;
                    on_low = 1;
                } else if (x == low)
                    on_low++;
                if (x == before) {
                    equal++;
                    continue;
                }
                double size = fabs(x - before);
                if (size > 0.0) { /* not a number before the first of all */
                    change += size;
                    if (size < least)
                        least = size;
                }
                over++;
                if (equal > most)
                    most = equal;
                equal = 1;
                before = x;
            }
            Size count = edges[h + 1] - edges[h], at = axis * hops + h;
            double per = count ? (double)count : 1.0;
            mean[at] = sum / per;
            level[at] = change / per;
            steps[at] = least;
            ended[at] = over;
            longest[at] = most;
            runs[at] = equal;
            top[at] = high;
            top[axes * hops + at] = -low;
            on_top[at] = on_high;
            on_top[axes * hops + at] = on_low;
        }
        if (n)
            last[axis] = own[n - 1];
        run[axis] = equal;
        step[axis] = least;
    }
    return leave(&a, 0);
}
