/* The largest values of an axis, hop by hop (`motion.rails`). */

#include "arrays.h"

enum { SIDES = 2, REMEMBERED = 64, LONG_STAY = 4, TAIL_HOPS = 120 };
enum Top { VALUE, BORN, ON, ONE_BELOW, TWO_BELOW, HAS_PILE, TOP };
enum Found { IS_REACHED, HIGHEST = IS_REACHED + SIDES, DROPPED = HIGHEST + SIDES, FOUND = DROPPED + SIDES };

/* Take a value as the latest top, as `_reach` does; whether it has to be weighed. */
static int reach(double (*tops)[TOP], int64_t *depth, double value, double on, double step,
                 double hop, double *dropped)
{
    Size n = (Size)*depth;
    double one_below = 0.0, two_below = 0.0, two_steps = 2.5 * step, lower = -INFINITY;
    double *last = NULL;
    while (n) {
        last = tops[n - 1];
        lower = value - last[VALUE];
        if (lower <= 0.0)
            break;
        n--;
        if (lower < two_steps) {
            if (lower < 1.5 * step) {
                one_below += last[ON];
                two_below += last[ONE_BELOW];
            } else
                two_below += last[ON];
        }
    }
    *depth = n;
    if (!n)
        lower = -INFINITY;
    if (lower == 0.0) {
        last[ON] += on; /* those below it were added when they came */
        return 1;
    }
    if (-lower < two_steps) {
        if (-lower < 1.5 * step)
            last[ONE_BELOW] += on;
        else
            last[TWO_BELOW] += on;
    }
    if (n == REMEMBERED) {
        Size k = 0;
        while (k < n && tops[k][HAS_PILE] != 0.0)
            k++;
        k = k == n ? 0 : k;
        if (tops[k][HAS_PILE] != 0.0)
            *dropped = tops[k][VALUE];
        memmove(tops[k], tops[k + 1], (size_t)(n - 1 - k) * sizeof tops[0]);
        n--;
    }
    double new[TOP] = {value, hop, on, one_below, two_below, 0.0};
    memcpy(tops[n], new, sizeof new);
    *depth = n + 1;
    return on >= (double)LONG_STAY;
}

/* Let go what lies below a value that was reached at rest. */
static void drop_below(double (*tops)[TOP], int64_t *depth, double value)
{
    while (*depth && tops[*depth - 1][VALUE] < value)
        (*depth)--;
}

/* Take hops[begin], hops[begin + 1], ... up to one whose top has to be weighed, or after which a
   pile is let go for want of room.

   moving: (H,) of all hops. tops, on: (SIDES, H); step, level: (H,). rows: (SIDES, REMEMBERED + 1, TOP)
   tops that nothing has gone beyond, depth: (SIDES,) how many. usual: (1,) mean change; count: (1,)
   hops of driving so far. recent: (SIDES, TAIL_HOPS) tops of the last of them, in turn. found: (FOUND,) whether the last hop is to be weighed, by side; the largest
   value of these hops; the value of the pile that was let go. Returns the place of the hop that is to
   be weighed, else of the first that was not taken. */
KERNEL long rail_hops(PyObject *hops_, long begin, PyObject *moving_, PyObject *tops_, PyObject *on_,
                      PyObject *step_, PyObject *level_, PyObject *rows_, PyObject *depth_,
                      PyObject *usual_, PyObject *count_, PyObject *recent_, PyObject *found_)
{
    Arrays a = {0};
    const int64_t *hops = take(&a, hops_, 'q', SHAPE(ANY));
    Size n = length_of(&a, 0);
    const uint8_t *moving = flags_in(&a, moving_, SHAPE(ANY));
    Size all = length_of(&a, 0);
    const double *tops = doubles(&a, tops_, SHAPE(SIDES, all));
    const int64_t *on = take(&a, on_, 'q', SHAPE(SIDES, all));
    const double *step = doubles(&a, step_, SHAPE(all));
    const double *level = doubles(&a, level_, SHAPE(all));
    double *rows = doubles_out(&a, rows_, SHAPE(SIDES, REMEMBERED + 1, TOP));
    int64_t *depth = take_out(&a, depth_, 'q', SHAPE(SIDES));
    double *usual = doubles_out(&a, usual_, SHAPE(1));
    int64_t *count = take_out(&a, count_, 'q', SHAPE(1));
    double *recent = doubles_out(&a, recent_, SHAPE(SIDES, TAIL_HOPS));
    double *found = doubles_out(&a, found_, SHAPE(FOUND));
    if (a.failed)
        return leave(&a, -1);
    int fits = begin >= 0 && begin <= n && *count >= 0 && *count <= LARGEST_COUNT;
    for (int side = 0; side < SIDES; side++)
        fits = fits && depth[side] >= 0 && depth[side] <= REMEMBERED;
    for (Size k = 0; k < n; k++)
        fits = fits && hops[k] >= 0 && hops[k] < all;
    if (!fits)
        return leave(&a, refuse(&a, "hops beyond those of an axis"));
    for (int side = 0; side < SIDES; side++) {
        found[IS_REACHED + side] = 0.0;
        found[HIGHEST + side] = -INFINITY;
        found[DROPPED + side] = NAN;
    }
    Size k;
    for (k = begin; k < n; k++) {
        Size h = (Size)hops[k];
        if (!moving[h]) {
            for (int side = 0; side < SIDES; side++) {
                double value = tops[side * all + h];
                double (*own)[TOP] = (double (*)[TOP])(rows + side * (REMEMBERED + 1) * TOP);
                found[HIGHEST + side] = value > found[HIGHEST + side] ? value : found[HIGHEST + side];
                drop_below(own, &depth[side], value);
            }
            continue;
        }
        double hop = (double)(*count)++;
        *usual += (level[h] - *usual) / (hop < (double)TAIL_HOPS ? hop + 1.0 : (double)TAIL_HOPS);
        for (int side = 0; side < SIDES; side++) {
            double value = tops[side * all + h];
            double (*own)[TOP] = (double (*)[TOP])(rows + side * (REMEMBERED + 1) * TOP);
            recent[side * TAIL_HOPS + (Size)((*count - 1) % TAIL_HOPS)] = value;
            found[HIGHEST + side] = value > found[HIGHEST + side] ? value : found[HIGHEST + side];
            found[IS_REACHED + side] = reach(own, &depth[side], value, (double)on[side * all + h],
                                             step[h], hop, &found[DROPPED + side]);
        }
        if (found[IS_REACHED] != 0.0 || found[IS_REACHED + 1] != 0.0)
            break;
        if (found[DROPPED] == found[DROPPED] || found[DROPPED + 1] == found[DROPPED + 1]) {
            k++;
            break;
        }
    }
    return leave(&a, (long)k);
}
