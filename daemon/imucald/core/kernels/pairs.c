/* Pairs of signals that must show the same motion, and other sums over the ticks of a block. */

#include "numerics.h"

enum { MOST_TICKS = 256 };
enum Pair { YAW_RATE, STEERING, TURNS, HARD_TURNS, SPEED, PAIRS };
enum Figure { OFFSET, BEND, UNDERSTEER, MOVING, LEAST_NOISE, NOISE, TURNS_FROM, HARD_FROM, FIGURES };
enum Asked { ASK_YAW_RATE = 1, ASK_STEERING = 2, ASK_FORCES = 4 };

/* Two signals, of the ticks that are in use. */
typedef struct {
    double x[MOST_TICKS], y[MOST_TICKS];
    Size n;
} Both;

static inline void put(Both *both, double x, double y, int is_used)
{
    both->x[both->n] = x;
    both->y[both->n] = y;
    both->n += is_used;
}

/* How many, and the sums of x x, x y, y y. */
static void sum_up(const Both *both, double *out)
{
    double product[MOST_TICKS];
    const double *left[3] = {both->x, both->x, both->y}, *right[3] = {both->x, both->y, both->y};
    out[0] = (double)both->n;
    for (int i = 0; i < 3; i++) {
        for (Size k = 0; k < both->n; k++)
            product[k] = left[i][k] * right[i][k];
        out[1 + i] = sum_of(product, both->n, 1);
    }
}

/* What `contradictions.PairWatch` takes of a block, of the pairs that are asked: (PAIRS, 4).

   R: (3, 3) the mount. late: the speed, behind the force [ticks]. */
KERNEL long signal_pairs(PyObject *speed_, PyObject *accel_, PyObject *yaw_rate_, PyObject *turn_rate_,
                         PyObject *steering_, PyObject *force_, PyObject *ok_speed_,
                         PyObject *ok_yaw_, PyObject *ok_rate_, PyObject *ok_force_,
                         PyObject *ok_steering_, PyObject *learn_, PyObject *R_, PyObject *figures_,
                         long late, long asked, PyObject *out_)
{
    Arrays a = {0};
    const double *speed = doubles(&a, speed_, SHAPE(ANY));
    Size n = length_of(&a, 0);
    const double *accel = doubles(&a, accel_, SHAPE(n));
    const double *yaw_rate = doubles(&a, yaw_rate_, SHAPE(n));
    const double *turn_rate = doubles(&a, turn_rate_, SHAPE(n));
    const double *steering = doubles(&a, steering_, SHAPE(n));
    const double *force = doubles(&a, force_, SHAPE(n, 3));
    const uint8_t *ok_speed = flags_in(&a, ok_speed_, SHAPE(n));
    const uint8_t *ok_yaw = flags_in(&a, ok_yaw_, SHAPE(n));
    const uint8_t *ok_rate = flags_in(&a, ok_rate_, SHAPE(n));
    const uint8_t *ok_force = flags_in(&a, ok_force_, SHAPE(n));
    const uint8_t *ok_steering = flags_in(&a, ok_steering_, SHAPE(n));
    const uint8_t *learn = flags_in(&a, learn_, SHAPE(n));
    const double *R = doubles(&a, R_, SHAPE(3, 3));
    const double *figure = doubles(&a, figures_, SHAPE(FIGURES));
    double *out = doubles_out(&a, out_, SHAPE(PAIRS, 4));
    if (a.failed)
        return leave(&a, -1);
    if (n < 3 || n >= MOST_TICKS || late <= -n || late >= n)
        return leave(&a, refuse(&a, "more ticks than a block has"));
    begin();
    Both both;
    memset(out, 0, PAIRS * 4 * sizeof *out);
    if (asked & ASK_YAW_RATE) {
        both.n = 0;
        for (Size k = 0; k < n; k++)
            put(&both, yaw_rate[k], turn_rate[k],
                ok_yaw[k] & ok_rate[k] & ok_speed[k] & (fabs(speed[k]) > figure[MOVING]));
        sum_up(&both, out + 4 * YAW_RATE);
    }
    if (asked & ASK_STEERING) {
        both.n = 0;
        for (Size k = 0; k < n; k++) {
            double bend = figure[BEND] * (1.0 + figure[UNDERSTEER] * speed[k] * speed[k]);
            double steered = speed[k] * (steering[k] - figure[OFFSET]) / bend;
            put(&both, steered, turn_rate[k],
                ok_steering[k] & ok_speed[k] & (fabs(speed[k]) > figure[MOVING]) &
                    (ok_rate[k] | ok_yaw[k]));
        }
        sum_up(&both, out + 4 * STEERING);
    }
    if (!(asked & ASK_FORCES))
        return leave(&a, raised());
    double square[MOST_TICKS], fastest = 0.0;
    for (Size k = 1; k < n - 1; k++) {
        double left = turn_rate[k] - 0.5 * (turn_rate[k - 1] + turn_rate[k + 1]);
        square[k - 1] = left * left;
    }
    for (Size k = 0; k < n; k++)
        fastest = larger(fastest, fabs(speed[k]));
    double own = sqrt(sum_of(square, n - 2, 1) / (1.5 * (double)(n - 2)));
    own = figure[LEAST_NOISE] > own ? figure[LEAST_NOISE] : own;
    double noise = figure[NOISE] * own * fastest;
    Size now = late < 0 ? -late : 0, then = late > 0 ? late : 0, count = n - now - then;
    double turn[MOST_TICKS], ahead[MOST_TICKS], across[MOST_TICKS], change[MOST_TICKS];
    uint8_t use[MOST_TICKS], turning[MOST_TICKS];
    for (Size k = 0; k < count; k++) {
        const double *f = force + 3 * (now + k);
        ahead[k] = f[0] * R[0] + f[1] * R[1] + f[2] * R[2];
        across[k] = f[0] * R[3] + f[1] * R[4] + f[2] * R[5];
        turn[k] = speed[then + k] * turn_rate[now + k];
        change[k] = accel[then + k];
        use[k] = ok_speed[then + k] & (fabs(speed[then + k]) > figure[MOVING]) & ok_force[now + k] &
                 learn[now + k];
        turning[k] = use[k] & (ok_rate[now + k] | ok_yaw[now + k]);
    }
    for (int hard = 0; hard < 2; hard++) {
        double from = figure[TURNS_FROM + hard];
        if (!(noise < from))
            continue;
        both.n = 0;
        for (Size k = 0; k < count; k++)
            put(&both, turn[k], across[k], turning[k] & (fabs(turn[k]) > from));
        sum_up(&both, out + 4 * (TURNS + hard));
    }
    double usual = sum_of(change, count, 1) / (double)count;
    double level = sum_of(ahead, count, 1) / (double)count;
    both.n = 0;
    for (Size k = 0; k < count; k++)
        put(&both, change[k] - usual, ahead[k] - level, use[k]);
    sum_up(&both, out + 4 * SPEED);
    return leave(&a, raised());
}

/* Sums that the steering's offset follows from (`steering`): of ticks in use above a speed and below
   a lateral force, how many, r / v, r v, their squares and product, the angle and it times both. */
KERNEL long steering_sums(PyObject *angle_, PyObject *speed_, PyObject *rate_, PyObject *use_,
                          double slowest, double hardest, PyObject *out_)
{
    Arrays a = {0};
    const double *angle = doubles(&a, angle_, SHAPE(ANY));
    Size n = length_of(&a, 0);
    const double *speed = doubles(&a, speed_, SHAPE(n));
    const double *rate = doubles(&a, rate_, SHAPE(n));
    const uint8_t *use = flags_in(&a, use_, SHAPE(n));
    double *out = doubles_out(&a, out_, SHAPE(9));
    if (a.failed)
        return leave(&a, -1);
    begin();
    memset(out, 0, 9 * sizeof *out);
    for (Size k = 0; k < n; k++) {
        double v = speed[k], r = rate[k], lateral = v * r;
        if (!(use[k] && v > slowest && fabs(lateral) < hardest))
            continue;
        double bend = r / v, of[9] = {1.0,  bend, lateral,  bend * bend,     bend * lateral, lateral * lateral,
                                      angle[k], angle[k] * bend, angle[k] * lateral};
        for (int i = 0; i < 9; i++)
            out[i] += of[i];
    }
    return leave(&a, raised());
}

/* Sums of vectors (n, 3) where `use` holds: how many, and of each axis. */
KERNEL long masked_sums(PyObject *values_, PyObject *use_, PyObject *out_)
{
    Arrays a = {0};
    const double *values = doubles(&a, values_, SHAPE(ANY, 3));
    Size n = length_of(&a, 0);
    const uint8_t *use = flags_in(&a, use_, SHAPE(n));
    double *out = doubles_out(&a, out_, SHAPE(4));
    if (a.failed)
        return leave(&a, -1);
    begin();
    memset(out, 0, 4 * sizeof *out);
    for (Size k = 0; k < n; k++) {
        double one = use[k] ? 1.0 : 0.0;
        out[0] += one;
        for (int i = 0; i < 3; i++)
            out[1 + i] += values[3 * k + i] * one;
    }
    return leave(&a, raised());
}

/* How many changes of a mean, up to `most` - 1 blocks ago and two at least, are of a size
   (`large_change`): e: (n, axes), w: (n,) weights; out: (1,). */
KERNEL long large_turns(PyObject *e_, PyObject *w_, long most, double least, PyObject *out_)
{
    Arrays a = {0};
    const double *e = doubles(&a, e_, SHAPE(ANY, ANY));
    Size n = length_of(&a, 0), axes = length_of(&a, 1);
    const double *w = doubles(&a, w_, SHAPE(n));
    double *out = doubles_out(&a, out_, SHAPE(1));
    if (a.failed)
        return leave(&a, -1);
    if (most < 2 || most > n)
        return leave(&a, refuse(&a, "more blocks than there are"));
    begin();
    out[0] = 0.0;
    double weight[MOST_TICKS], sum[MOST_TICKS];
    if (most > MOST_TICKS)
        return leave(&a, refuse(&a, "more blocks than are looked at"));
    double all = 0.0;
    for (Size k = 0; k < n; k++) {
        all = k ? all + w[n - 1 - k] : w[n - 1];
        if (k < most)
            weight[k] = all;
    }
    for (Size i = 0; i < axes; i++) {
        double whole = 0.0;
        for (Size k = 0; k < n; k++) {
            double own = w[n - 1 - k] * e[(n - 1 - k) * axes + i];
            whole = k ? whole + own : own;
            if (k < most)
                sum[k] = whole;
        }
        for (Size k = 1; k < most; k++) {
            double size = sum[k] / weight[k] - (whole - sum[k]) / (all - weight[k]);
            out[0] += !(fabs(size) < least);
        }
    }
    return leave(&a, raised());
}
