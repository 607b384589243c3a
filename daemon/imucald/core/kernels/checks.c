/* What a block of signals says against others: of signs and axes, of the sensor's turning. */

#include "numerics.h"

enum { MOST_TICKS = 256, HALF = 7, AROUND = 5 };

/* Sums over a pair of signals where `use` holds (`contradictions`, `log_ratios`).

   centred: about their means. out: (4,) how many, of x x, x y, y y. */
KERNEL long pair_sums(PyObject *x_, PyObject *y_, PyObject *use_, long centred, PyObject *out_)
{
    Arrays a = {0};
    const double *x = doubles(&a, x_, SHAPE(ANY));
    Size n = length_of(&a, 0);
    const double *y = doubles(&a, y_, SHAPE(n));
    const uint8_t *use = flags_in(&a, use_, SHAPE(n));
    double *out = doubles_out(&a, out_, SHAPE(4));
    if (a.failed)
        return leave(&a, -1);
    if (n > MOST_TICKS)
        return leave(&a, refuse(&a, "more ticks than a block has"));
    begin();
    double u[MOST_TICKS], v[MOST_TICKS], product[MOST_TICKS];
    Size count = 0;
    for (Size k = 0; k < n; k++)
        if (use[k]) {
            u[count] = x[k];
            v[count++] = y[k];
        }
    if (centred && count) {
        double of_u = sum_of(u, count, 1) / (double)count, of_v = sum_of(v, count, 1) / (double)count;
        for (Size k = 0; k < count; k++) {
            u[k] -= of_u;
            v[k] -= of_v;
        }
    }
    const double *left[3] = {u, u, v}, *right[3] = {u, v, v};
    for (int i = 0; i < 3; i++) {
        for (Size k = 0; k < count; k++)
            product[k] = left[i][k] * right[i][k];
        out[1 + i] = sum_of(product, count, 1);
    }
    out[0] = (double)count;
    return leave(&a, raised());
}

/* Sums over the ticks of a block where `use` holds (`block_sums`).

   out: (8,) how many; of the force (3,), dv/dt, speed times turn rate, the speed's size; its largest. */
KERNEL long block_sums(PyObject *use_, PyObject *force_, PyObject *accel_, PyObject *speed_,
                       PyObject *rate_, PyObject *out_)
{
    Arrays a = {0};
    const uint8_t *use = flags_in(&a, use_, SHAPE(ANY));
    Size n = length_of(&a, 0);
    const double *force = doubles(&a, force_, SHAPE(n, 3));
    const double *accel = doubles(&a, accel_, SHAPE(n));
    const double *speed = doubles(&a, speed_, SHAPE(n));
    const double *rate = doubles(&a, rate_, SHAPE(n));
    double *out = doubles_out(&a, out_, SHAPE(8));
    if (a.failed)
        return leave(&a, -1);
    if (n > MOST_TICKS)
        return leave(&a, refuse(&a, "more ticks than a block has"));
    begin();
    double change[MOST_TICKS], turn[MOST_TICKS], size[MOST_TICKS];
    memset(out, 0, 8 * sizeof *out);
    for (Size k = 0; k < n; k++) {
        double one = use[k] ? 1.0 : 0.0;
        out[0] += one;
        for (int i = 0; i < 3; i++)
            out[1 + i] += force[3 * k + i] * one;
        change[k] = accel[k] * one;
        turn[k] = speed[k] * rate[k] * one;
        size[k] = fabs(speed[k]) * one;
        out[7] = larger(out[7], size[k]);
    }
    out[4] = sum_of(change, n, 1);
    out[5] = sum_of(turn, n, 1);
    out[6] = sum_of(size, n, 1);
    return leave(&a, raised());
}

/* Energies that each signed permutation of the gyroscope's axes leaves over, as
   `gyro_alternatives._left_over` has them.

   turned: (HALF, 3, 3) the mount after each permutation. numbers: gain over gravity, seconds of a tick,
   the weight of the means, the least energy. out: (2 HALF, 2). */
KERNEL long gyro_energies(PyObject *ahead_, PyObject *across_, PyObject *rate_, PyObject *speed_,
                          PyObject *turned_, PyObject *numbers_, PyObject *out_)
{
    Arrays a = {0};
    const double *ahead = doubles(&a, ahead_, SHAPE(ANY));
    Size n = length_of(&a, 0);
    const double *across = doubles(&a, across_, SHAPE(n));
    const double *rate = doubles(&a, rate_, SHAPE(n, 3));
    const double *speed = doubles(&a, speed_, SHAPE(n));
    const double *turned = doubles(&a, turned_, SHAPE(HALF, 3, 3));
    const double *number = doubles(&a, numbers_, SHAPE(4));
    double *out = doubles_out(&a, out_, SHAPE(2 * HALF, 2));
    if (a.failed)
        return leave(&a, -1);
    if (n < 1 || n > MOST_TICKS)
        return leave(&a, refuse(&a, "more ticks than a block has"));
    begin();
    double gain[MOST_TICKS], aside[MOST_TICKS], first[MOST_TICKS];
    double longer[2][MOST_TICKS + 2 * AROUND], smooth[2][MOST_TICKS], r[3][MOST_TICKS];
    double left[2][2][MOST_TICKS];
    for (Size k = 0; k < n; k++)
        gain[k] = number[0] * speed[k];
    for (int s = 0; s < HALF; s++) {
        const double *m = turned + 9 * s;
        for (int i = 0; i < 3; i++)
            for (Size k = 0; k < n; k++)
                r[i][k] = m[3 * i] * rate[3 * k] + m[3 * i + 1] * rate[3 * k + 1] +
                          m[3 * i + 2] * rate[3 * k + 2];
        for (Size k = 0; k < n; k++)
            aside[k] = gain[k] * r[2][k];
        if (s == 0) { /* of the axes as they are, means over a second */
            memcpy(first, aside, (size_t)n * sizeof *first);
            for (Size k = 0; k < n + 2 * AROUND; k++) {
                Size at = k < AROUND ? 0 : k - AROUND >= n ? n - 1 : k - AROUND;
                longer[0][k] = ahead[at];
                longer[1][k] = across[at] - aside[at];
            }
            for (int i = 0; i < 2; i++)
                for (Size k = 0; k < n; k++) {
                    double sum = longer[i][k];
                    for (Size j = 1; j <= 2 * AROUND; j++)
                        sum += longer[i][k + j];
                    smooth[i][k] = sum * number[2];
                }
        }
        double moved[2] = {0.0, 0.0};
        /* all signs turned: what the rates move is the opposite */
        for (Size k = 0; k < n; k++) {
            moved[0] += r[2][k] * smooth[1][k] - r[1][k];
            moved[1] += r[0][k] - r[2][k] * smooth[0][k];
            double x = moved[0] * number[1], y = moved[1] * number[1];
            left[0][0][k] = ahead[k] - x;
            left[0][1][k] = across[k] - aside[k] - y;
            left[1][0][k] = x + ahead[k];
            left[1][1][k] = y + (across[k] + (s ? aside[k] : first[k]));
        }
        for (int way = 0; way < 2; way++) {
            int place = way ? (s ? HALF + s - 1 : 2 * HALF - 1) : s;
            for (int i = 0; i < 2; i++) {
                double *x = left[way][i], mean = sum_of(x, n, 1) / (double)n;
                for (Size k = 0; k < n; k++) {
                    x[k] -= mean;
                    x[k] *= x[k];
                }
                out[2 * place + i] = sum_of(x, n, 1) + number[3];
            }
        }
    }
    return leave(&a, raised());
}

enum { YAW_SIGNALS = 7 };

static void slope_of(const double *x, Size n, double tick, double *out)
{
    for (Size k = 1; k + 1 < n; k++)
        out[k] = (x[k + 1] - x[k - 1]) / (2.0 * tick);
    out[0] = (x[1] - x[0]) / tick;
    out[n - 1] = (x[n - 1] - x[n - 2]) / tick;
}

/* Sums of products of a block's force and motion about their means (`block_sums.block_yaw`).

   late: the speed, behind the force [ticks]. pairs: (P, 2) of signals. out: (1 + P,) how many, sums. */
KERNEL long yaw_sums(PyObject *force_, PyObject *accel_, PyObject *turn_, PyObject *rate_,
                     PyObject *use_, double late, double tick, PyObject *pairs_, PyObject *out_)
{
    Arrays a = {0};
    const double *force = doubles(&a, force_, SHAPE(ANY, 3));
    Size n = length_of(&a, 0);
    const double *accel = doubles(&a, accel_, SHAPE(n));
    const double *turn = doubles(&a, turn_, SHAPE(n));
    const double *rate = doubles(&a, rate_, SHAPE(n));
    const uint8_t *use = flags_in(&a, use_, SHAPE(n));
    const int64_t *pairs = take(&a, pairs_, 'q', SHAPE(ANY, 2));
    Size count = length_of(&a, 0);
    double *out = doubles_out(&a, out_, SHAPE(1 + count));
    if (a.failed)
        return leave(&a, -1);
    int fits = n >= 2 && n <= MOST_TICKS;
    for (Size k = 0; k < 2 * count; k++)
        fits = fits && pairs[k] >= 0 && pairs[k] < YAW_SIGNALS;
    if (!fits)
        return leave(&a, refuse(&a, "signals beyond those of a block"));
    begin();
    double each[YAW_SIGNALS][MOST_TICKS], product[MOST_TICKS];
    for (Size k = 0; k < n; k++) {
        each[0][k] = force[3 * k];
        each[1][k] = force[3 * k + 1];
        double at = (double)k + late;
        at = at > 0.0 ? at : 0.0;
        at = at < (double)(n - 1) ? at : (double)(n - 1);
        Size j = (Size)at < n - 2 ? (Size)at : n - 2;
        each[2][k] = (accel[j + 1] - accel[j]) * (at - (double)j) + accel[j];
        each[3][k] = turn[k];
        each[4][k] = rate[k] * rate[k];
    }
    slope_of(rate, n, tick, each[5]);
    slope_of(each[2], n, tick, each[6]);
    Size used = 0;
    for (Size k = 0; k < n; k++)
        if (use[k]) {
            for (int i = 0; i < YAW_SIGNALS; i++)
                each[i][used] = each[i][k];
            used++;
        }
    for (int i = 0; used && i < YAW_SIGNALS; i++) {
        double mean = sum_of(each[i], used, 1) / (double)used;
        for (Size k = 0; k < used; k++)
            each[i][k] -= mean;
    }
    out[0] = (double)used;
    for (Size p = 0; p < count; p++) {
        const double *x = each[pairs[2 * p]], *y = each[pairs[2 * p + 1]];
        for (Size k = 0; k < used; k++)
            product[k] = x[k] * y[k];
        out[1 + p] = sum_of(product, used, 1);
    }
    return leave(&a, raised());
}

enum { APART = 20 };

/* Whether the sensor turns alone, as `TurnedAlone.add` finds it.

   kept: (2, K) what both turned by before; the block's ticks go behind, less all up to the last where
   not both are known. numbers: still rate, seconds of a tick, gain share, least turn. both: (2, 2 N)
   room; used: (1,) how many ticks of it are filled. out: (1,) by how much. */
KERNEL long turned_alone(PyObject *kept_, PyObject *rate_, PyObject *vehicle_, PyObject *ok_,
                         PyObject *numbers_, PyObject *both_, PyObject *used_, PyObject *out_)
{
    Arrays a = {0};
    const double *kept = doubles(&a, kept_, SHAPE(2, ANY));
    Size before = length_of(&a, 1);
    const double *rate = doubles(&a, rate_, SHAPE(ANY));
    Size n = length_of(&a, 0);
    const double *vehicle = doubles(&a, vehicle_, SHAPE(n));
    const uint8_t *ok = flags_in(&a, ok_, SHAPE(n));
    const double *number = doubles(&a, numbers_, SHAPE(4));
    double *both = doubles_out(&a, both_, SHAPE(2, ANY));
    Size room = length_of(&a, 1);
    int64_t *used = take_out(&a, used_, 'q', SHAPE(1));
    double *out = doubles_out(&a, out_, SHAPE(1));
    if (a.failed)
        return leave(&a, -1);
    if (n > MOST_TICKS || before > APART || room < before + n)
        return leave(&a, refuse(&a, "more ticks than there is room for"));
    begin();
    Size first = 0, count = 0;
    for (Size k = 0; k < n; k++)
        if (!ok[k])
            first = k + 1;
    for (int i = 0; i < 2; i++) {
        const double *own = i ? vehicle : rate;
        count = 0;
        for (Size k = 0; !first && k < before; k++)
            both[i * room + count++] = kept[i * before + k];
        for (Size k = first; k < n; k++)
            both[i * room + count++] = own[k];
    }
    used[0] = count;
    out[0] = 0.0;
    if (count <= APART)
        return leave(&a, raised());
    const double *r = both, *v = both + room;
    double turned[MOST_TICKS + APART], path[MOST_TICKS + APART], sum = 0.0, way = 0.0;
    for (Size k = 0; k < count; k++) {
        sum += r[k] - v[k];
        way += fabs(v[k]);
        turned[k] = sum * number[1];
        path[k] = way * number[1];
    }
    Size best = 0;
    double most = 0.0;
    for (Size k = 0; k + APART < count; k++) {
        Size end = k + APART;
        int is_still = isless(fabs(r[k]), number[0]) && isless(fabs(v[k]), number[0]) &&
                       isless(fabs(r[end]), number[0]) && isless(fabs(v[end]), number[0]);
        double excess = fabs(turned[end] - turned[k]) - number[2] * (path[end] - path[k]);
        excess = is_still ? excess : 0.0;
        if (!k || isgreater(excess, most)) {
            most = excess;
            best = k;
        }
    }
    if (!isless(most, number[3])) {
        double own = sum_of(r + best + 1, APART, 1) * number[1];
        double alone = turned[best + APART] - turned[best];
        /* else the vehicle's signal is odd */
        if (!isless(own * alone, 0.0) && !isless(fabs(own), number[3]))
            out[0] = alone;
    }
    return leave(&a, raised());
}

enum Gravity { WEIGHT, FORCE, ACCEL = FORCE + 3, TURN, METRES, USED, RESTING, MOVING, EACH, GRAVITY };

/* What a block of driving or standing says of gravity, as `GravityEvidence.add` takes it.

   numbers: (missed / still)^2, metres of a tick at rest and of a stop at most, metres per m/s and tick.
   stop_used: of the stop so far [m]. out: (GRAVITY,) sums of the weight, and weighed with it; metres;
   then how many ticks are in use, at rest, and move; metres of each tick at rest. */
KERNEL long gravity_sums(PyObject *learn_, PyObject *ok_speed_, PyObject *rest_, PyObject *force_,
                         PyObject *speed_, PyObject *accel_, PyObject *turn_, PyObject *numbers_,
                         double stop_used, PyObject *out_)
{
    Arrays a = {0};
    const uint8_t *learn = flags_in(&a, learn_, SHAPE(ANY));
    Size n = length_of(&a, 0);
    const uint8_t *ok_speed = flags_in(&a, ok_speed_, SHAPE(n));
    const uint8_t *rest = flags_in(&a, rest_, SHAPE(n));
    const double *force = doubles(&a, force_, SHAPE(n, 3));
    const double *speed = doubles(&a, speed_, SHAPE(n));
    const double *accel = doubles(&a, accel_, SHAPE(n));
    const double *turn = doubles(&a, turn_, SHAPE(n));
    const double *number = doubles(&a, numbers_, SHAPE(4));
    double *out = doubles_out(&a, out_, SHAPE(GRAVITY));
    if (a.failed)
        return leave(&a, -1);
    if (n > MOST_TICKS)
        return leave(&a, refuse(&a, "more ticks than a block has"));
    begin();
    double weight[MOST_TICKS], product[MOST_TICKS], size[MOST_TICKS];
    memset(out, 0, GRAVITY * sizeof *out);
    for (Size k = 0; k < n; k++) {
        int use = learn[k] && (ok_speed[k] || rest[k]);
        out[USED] += use;
        out[RESTING] += use && rest[k];
        size[k] = fabs(speed[k]);
        out[MOVING] += isgreater(size[k], 1.0);
        double hard2 = accel[k] * accel[k] + turn[k] * turn[k];
        weight[k] = (rest[k] ? 0.0 : size[k] * number[3]) *
                    ((use ? 1.0 : 0.0) / (1.0 + hard2 * number[0]));
        size[k] *= use ? 1.0 : 0.0;
    }
    if (out[MOVING] > 0.0)
        stop_used = 0.0;
    if (out[RESTING] > 0.0) {
        double left = number[2] - stop_used;
        left = (left > 0.0 ? left : 0.0) / out[RESTING];
        out[EACH] = left < number[1] ? left : number[1];
        for (Size k = 0; k < n; k++)
            if (rest[k] && learn[k])
                weight[k] = out[EACH];
    }
    for (Size k = 0; k < n; k++)
        for (int i = 0; i < 3; i++)
            out[FORCE + i] += weight[k] * force[3 * k + i];
    out[WEIGHT] = sum_of(weight, n, 1);
    for (Size k = 0; k < n; k++)
        product[k] = weight[k] * accel[k];
    out[ACCEL] = sum_of(product, n, 1);
    for (Size k = 0; k < n; k++)
        product[k] = weight[k] * turn[k];
    out[TURN] = sum_of(product, n, 1);
    out[METRES] = sum_of(size, n, 1) * number[3];
    return leave(&a, raised());
}

/* Launches, brakings, turns to the left and to the right (`states.Manoeuvres`): counted are runs above a
   level. levels: (4,). state: (4, 3) how many, ticks of the run, whether it was counted. */
KERNEL long count_manoeuvres(PyObject *accel_, PyObject *turn_, PyObject *levels_, long least,
                             PyObject *state_)
{
    Arrays a = {0};
    const double *accel = doubles(&a, accel_, SHAPE(ANY));
    Size n = length_of(&a, 0);
    const double *turn = doubles(&a, turn_, SHAPE(n));
    const double *levels = doubles(&a, levels_, SHAPE(4));
    int64_t *state = take_out(&a, state_, 'q', SHAPE(4, 3));
    if (a.failed)
        return leave(&a, -1);
    for (int k = 0; k < 12; k++)
        if (state[k] < 0 || state[k] > LARGEST_COUNT)
            return leave(&a, refuse(&a, "counts beyond those of manoeuvres"));
    for (int k = 0; k < 4; k++) {
        const double *values = k < 2 ? accel : turn;
        double sign = k % 2 ? -1.0 : 1.0, level = levels[k];
        int64_t *own = state + 3 * k, *run = own + 1, *is_over = own + 2;
        int is_above = *is_over != 0;
        for (Size i = 0; i < n && !is_above; i++)
            is_above = sign * values[i] > level;
        if (!is_above) {
            *run = 0;
            continue;
        }
        for (Size i = 0; i < n; i++) {
            double value = sign * values[i];
            if (value > level) {
                ++*run;
                if (*run == least && !*is_over) {
                    ++*own;
                    *is_over = 1;
                }
            } else if (value < 0.5 * level)
                *run = *is_over = 0;
        }
    }
    return leave(&a, 0);
}

/* Add a window's spectra to the sums that a delay follows from (`delay`): signal (bins,), force
   (bins, 3). cross: (bins, 3); powers: (2, bins) of the signal and of the force. used: (1,) whether the
   signal has as much power as `least`. */
KERNEL long add_cross_spectra(PyObject *signal_, PyObject *force_, double least, PyObject *cross_,
                              PyObject *powers_, PyObject *used_)
{
    Arrays a = {0};
    const double *signal = take(&a, signal_, 'D', SHAPE(ANY));
    Size n = length_of(&a, 0);
    const double *force = take(&a, force_, 'D', SHAPE(n, 3));
    double *cross = take_out(&a, cross_, 'D', SHAPE(n, 3));
    double *powers = doubles_out(&a, powers_, SHAPE(2, n));
    int64_t *used = take_out(&a, used_, 'q', SHAPE(1));
    if (a.failed)
        return leave(&a, -1);
    if (n < 1 || n > MOST_TICKS)
        return leave(&a, refuse(&a, "more bins than a window has"));
    begin();
    double power[MOST_TICKS];
    for (Size k = 0; k < n; k++)
        power[k] = signal[2 * k] * signal[2 * k] + signal[2 * k + 1] * signal[2 * k + 1];
    *used = !(sum_of(power, n, 1) < least);
    if (!*used)
        return leave(&a, raised());
    for (Size k = 0; k < n; k++) {
        double re = signal[2 * k], im = signal[2 * k + 1], sum = 0.0;
        for (int i = 0; i < 3; i++) {
            double x = force[6 * k + 2 * i], y = force[6 * k + 2 * i + 1];
            cross[6 * k + 2 * i] += re * x + im * y;
            cross[6 * k + 2 * i + 1] += re * y - im * x;
            sum += x * x + y * y;
        }
        powers[k] += power[k];
        powers[n + k] += sum;
    }
    return leave(&a, raised());
}
