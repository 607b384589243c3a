/* Frames of a chunk: their stream times, and which route each belongs to. */

#include "arrays.h"

enum { STANDARD = 2048, SEVERAL = -2 };

/* Stream times of stamps[start:], up to one that steps, as `TimeBase.stream_time` has them.

   numbers: offset; stream time so far; the newest stamp; the highest of all segments; how far a
   stamp may go back, and how far forward where none has been before. The second and the third go on.
   Returns the place of the stamp that steps, or how many there are; one that is not a number does. */
KERNEL long stream_times(PyObject *stamps_, long start, PyObject *numbers_, PyObject *t_)
{
    Arrays a = {0};
    const double *stamps = doubles(&a, stamps_, SHAPE(ANY));
    Size n = length_of(&a, 0);
    double *numbers = doubles_out(&a, numbers_, SHAPE(6));
    double *t = doubles_out(&a, t_, SHAPE(ANY));
    Size room = length_of(&a, 0);
    if (a.failed)
        return leave(&a, -1);
    if (start < 0 || start > n || room < n - start)
        return leave(&a, refuse(&a, "numbers beyond the arrays of stream_times"));
    double offset = numbers[0], now = numbers[1], newest = numbers[2], highest = numbers[3];
    double back = numbers[4], forward = numbers[5];
    Size i = start;
    for (; i < n; i++) {
        double stamp = stamps[i];
        if (i > start && !(stamp - newest >= -back &&
                           stamp - newest <= (stamp > highest ? forward : back)))
            break;
        newest = stamp > newest ? stamp : newest;
        now = stamp - offset > now ? stamp - offset : now;
        t[i - start] = now;
    }
    numbers[1] = now;
    numbers[2] = newest;
    return leave(&a, (long)i);
}

/* The rows of the frames of each route, one route after another.

   table: (STANDARD,) the route of each id of 11 bits, -1 none, -2 several. pairs: (R, 2) id and mask
   of each route. which: (n,) scratch. ends: (R,) where the rows of each end. Returns 1 where a frame
   belongs to several routes. */
KERNEL long match_frames(PyObject *id_, PyObject *table_, PyObject *pairs_, PyObject *which_,
                         PyObject *rows_, PyObject *ends_)
{
    Arrays a = {0};
    const uint32_t *id = take(&a, id_, 'I', SHAPE(ANY));
    Size n = length_of(&a, 0);
    const int16_t *table = take(&a, table_, 'h', SHAPE(STANDARD));
    const uint32_t *pairs = take(&a, pairs_, 'I', SHAPE(ANY, 2));
    Size routes = length_of(&a, 0);
    int16_t *which = take_out(&a, which_, 'h', SHAPE(n));
    int64_t *rows = take_out(&a, rows_, 'q', SHAPE(n));
    int64_t *ends = take_out(&a, ends_, 'q', SHAPE(routes));
    if (a.failed)
        return leave(&a, -1);
    int fits = routes <= INT16_MAX;
    for (Size k = 0; k < STANDARD; k++)
        fits = fits && table[k] >= SEVERAL && table[k] < routes;
    if (!fits)
        return leave(&a, refuse(&a, "a table of other routes"));
    memset(ends, 0, (size_t)routes * sizeof *ends);
    for (Size i = 0; i < n; i++) {
        int found = -1;
        if (id[i] < STANDARD)
            found = table[id[i]];
        else
            for (Size k = 0; k < routes; k++)
                if ((id[i] & pairs[2 * k + 1]) == pairs[2 * k])
                    found = found == -1 ? (int)k : SEVERAL;
        if (found == SEVERAL)
            return leave(&a, 1);
        which[i] = (int16_t)found;
        if (found >= 0)
            ends[found]++;
    }
    for (Size k = 0, before = 0; k < routes; k++) {
        Size many = (Size)ends[k];
        ends[k] = before;
        before += many;
    }
    for (Size i = 0; i < n; i++)
        if (which[i] >= 0)
            rows[ends[which[i]]++] = i;
    return leave(&a, 0);
}
