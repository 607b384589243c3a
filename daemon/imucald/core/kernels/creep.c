/* The filters of walks and rates, segment by segment (`mount.creep`). */

#include "numerics.h"

enum { AXES = 3 };

static inline void go_on(double *state, double *P, Size each, Size at, double step, double walk)
{
    state[at] += step * state[each + at];
    double after = P[each + at] + step * P[2 * each + at];
    P[at] += step * (P[each + at] + after + walk);
    P[each + at] = after;
}

/* Run them over n segments, as `creep._filtered` does.

   value, noise, gaps: (n, AXES); goes_on, begins: the same, flags. walks: (K,) variances. off, spread:
   (n, AXES, K) of each segment. state: (2, AXES, K) level and rate; P: (3, AXES, K) of the level, of
   both, of the rate. last: (AXES,) how far to go on at the end. */
KERNEL long creep_filters(PyObject *value_, PyObject *noise_, PyObject *gaps_, PyObject *goes_on_,
                          PyObject *begins_, PyObject *walks_, PyObject *last_, PyObject *off_,
                          PyObject *spread_, PyObject *state_, PyObject *P_)
{
    Arrays a = {0};
    const double *value = doubles(&a, value_, SHAPE(ANY, AXES));
    Size n = length_of(&a, 0);
    const double *noise = doubles(&a, noise_, SHAPE(n, AXES));
    const double *gaps = doubles(&a, gaps_, SHAPE(n, AXES));
    const uint8_t *goes = flags_in(&a, goes_on_, SHAPE(n, AXES));
    const uint8_t *begins = flags_in(&a, begins_, SHAPE(n, AXES));
    const double *walks = doubles(&a, walks_, SHAPE(ANY));
    Size filters = length_of(&a, 0), each = AXES * filters;
    const double *last = doubles(&a, last_, SHAPE(AXES));
    double *off = doubles_out(&a, off_, SHAPE(n, AXES, filters));
    double *spread = doubles_out(&a, spread_, SHAPE(n, AXES, filters));
    double *state = doubles_out(&a, state_, SHAPE(2, AXES, filters));
    double *P = doubles_out(&a, P_, SHAPE(3, AXES, filters));
    if (a.failed)
        return leave(&a, -1);
    begin();
    for (Size k = 0; k < n; k++)
        for (Size axis = 0; axis < AXES; axis++) {
            Size of = AXES * k + axis;
            for (Size f = 0; f < filters; f++) {
                Size at = filters * axis + f;
                go_on(state, P, each, at, gaps[of], walks[f]);
                double left = off[each * k + at] = value[of] - state[at];
                double around = spread[each * k + at] = P[at] + noise[of];
                double gain = P[at] / around, of_rate = P[each + at] / around;
                if (!goes[of]) {
                    gain *= 0.0;
                    of_rate *= 0.0;
                }
                P[2 * each + at] -= of_rate * P[each + at];
                P[at] -= gain * P[at];
                P[each + at] -= gain * P[each + at];
                state[at] += gain * left;
                state[each + at] += of_rate * left;
                if (begins[of]) {
                    state[at] = value[of];
                    P[at] = noise[of];
                }
            }
        }
    for (Size axis = 0; axis < AXES; axis++)
        for (Size f = 0; f < filters; f++)
            go_on(state, P, each, filters * axis + f, last[axis], walks[f]);
    return leave(&a, raised());
}
