/* The vertical's filter, block by block (`mount.vertical_block`, `mount.gravity_step`). */

#include "numerics.h"

enum { WIDE = 7, MOST_TICKS = 256 };
enum Numbers { TICK_S, GRAVITY, SETTLE_TICKS, NOISE2, SHARE2, LARGE, LARGE_STEP, NUMBERS };

/* (3, 3) of rows so far apart times (3, k): sums from left to right. */
static inline void times(const double *m, Size m_row, const double *y, Size y_row, Size k,
                         double *out, Size out_row)
{
    for (Size i = 0; i < 3; i++)
        for (Size j = 0; j < k; j++)
            out[i * out_row + j] = m[i * m_row] * y[j] + m[i * m_row + 1] * y[y_row + j] +
                                   m[i * m_row + 2] * y[2 * y_row + j];
}

static inline double square_of(const double *v)
{
    return v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
}

static void turn_by(const double *rate, const double *drift, double ok, double tick, double *turn)
{
    double s[3];
    for (int k = 0; k < 3; k++)
        s[k] = -tick * (rate[k] - drift[k]) * ok;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            turn[3 * i + j] = 0.5 * s[i] * s[j];
    double rest = 1.0 - (turn[0] + turn[4] + turn[8]);
    turn[0] += rest;
    turn[4] += rest;
    turn[8] += rest;
    turn[1] -= s[2];
    turn[2] += s[1];
    turn[5] -= s[0];
    turn[3] += s[2];
    turn[6] -= s[1];
    turn[7] += s[0];
}

/* A carry after an earlier one. */
static void follow(double *carry, const double *earlier)
{
    double both[3 * WIDE];
    times(carry, WIDE, earlier, WIDE, WIDE, both, WIDE);
    for (int r = 0; r < 3; r++)
        for (int c = 3; c < WIDE; c++)
            both[WIDE * r + c] += carry[WIDE * r + c];
    memcpy(carry, both, sizeof both);
}

/* Each carry with all before it, twice as many a step. */
static void put_together(double (*carry)[3 * WIDE], Size n)
{
    for (Size apart = 1; apart < n; apart *= 2)
        for (Size k = n - 1; k >= apart; k--)
            follow(carry[k], carry[k - apart]);
}

/* The state after a carry. */
static void draw(const double *carry, const double *state, double *after)
{
    times(carry, WIDE, state, WIDE, WIDE, after, WIDE);
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 4; c++)
            after[WIDE * r + c] += carry[WIDE * r + 3 + c];
}

/* What n ticks show: answers (3, k) of each, k numbers of `wide`, what is left (3,), weights. */
typedef struct {
    double answer[3 * 6][MOST_TICKS], left[3][MOST_TICKS], weight[MOST_TICKS];
} Shown;

/* Information (k, k) and score (k,) below it. */
static void weigh(const Shown *s, Size n, int k, double *sums)
{
    double weighted[3 * 6][MOST_TICKS], each[MOST_TICKS];
    for (int r = 0; r < 3; r++)
        for (int i = 0; i < k; i++)
            for (Size t = 0; t < n; t++)
                weighted[6 * r + i][t] = s->answer[6 * r + i][t] * s->weight[t];
    for (int j = 0; j < k + 1; j++)
        for (int i = 0; i < k; i++) {
            const double *x = j < k ? s->answer[j] : s->left[0];
            const double *y = j < k ? s->answer[6 + j] : s->left[1];
            const double *z = j < k ? s->answer[12 + j] : s->left[2];
            for (Size t = 0; t < n; t++)
                each[t] = weighted[i][t] * x[t] + weighted[6 + i][t] * y[t] + weighted[12 + i][t] * z[t];
            sums[k * j + i] = sum_of(each, n, 1);
        }
}

/* Carry the vertical through n ticks, as `vertical_block.carried` does from a state that is known.

   last: (3, 7) state and what is left of it, at the beginning and then at the end. sums: of what is not
   explained (3,), the largest answer, u at the last tick (3,). */
KERNEL long vertical(PyObject *rate_, PyObject *drift_, PyObject *ok_rate_, PyObject *force_,
                     PyObject *motion_, PyObject *bias_, PyObject *use_, PyObject *learn_,
                     PyObject *numbers_, double pull, long first, long count, long has_motion,
                     long weighed, PyObject *lone_, PyObject *last_, PyObject *sums_,
                     PyObject *of_bias_, PyObject *of_steps_)
{
    Arrays a = {0};
    const double *rate = doubles(&a, rate_, SHAPE(ANY, 3));
    Size n = length_of(&a, 0);
    const double *drift = doubles(&a, drift_, SHAPE(3));
    const uint8_t *ok_rate = flags_in(&a, ok_rate_, SHAPE(n));
    const double *force = doubles(&a, force_, SHAPE(n, 3));
    const double *motion = doubles(&a, motion_, SHAPE(n, 3));
    const double *bias = doubles(&a, bias_, SHAPE(3));
    const uint8_t *use = flags_in(&a, use_, SHAPE(n));
    const uint8_t *learn = flags_in(&a, learn_, SHAPE(n));
    const double *number = doubles(&a, numbers_, SHAPE(NUMBERS));
    double *lone = doubles_out(&a, lone_, SHAPE(n, 3));
    double *last = doubles_out(&a, last_, SHAPE(3, WIDE));
    double *sums = doubles_out(&a, sums_, SHAPE(WIDE));
    double *of_bias = doubles_out(&a, of_bias_, SHAPE(4, 3));
    double *of_steps = doubles_out(&a, of_steps_, SHAPE(7, 6));
    if (a.failed)
        return leave(&a, -1);
    if (n < 1 || n > MOST_TICKS || first < 0 || first >= n || count < 0 || count > LONG_MAX - n)
        return leave(&a, refuse(&a, "a block of so many ticks is not carried"));
    begin();
    double turn[MOST_TICKS][9], carry[MOST_TICKS][3 * WIDE], states[3 * WIDE], drawn[3 * WIDE];
    double g = number[GRAVITY];
    for (Size i = 0; i < n; i++) {
        turn_by(rate + 3 * i, drift, ok_rate[i] ? 1.0 : 0.0, number[TICK_S], turn[i]);
        count += use[i] != 0;
        double gain = 0.0;
        if (use[i])
            gain = (double)count > number[SETTLE_TICKS]
                       ? pull
                       : larger(pull, 1.0 / (count > 1 ? (double)count : 1.0));
        double *own = carry[i], part = gain / g;
        for (int r = 0; r < 3; r++) {
            for (int c = 0; c < 3; c++) {
                own[WIDE * r + c] = i < first ? (r == c) : (1.0 - gain) * turn[i][3 * r + c];
                own[WIDE * r + 4 + c] = r == c ? gain : 0.0;
            }
            double f = has_motion ? force[3 * i + r] - motion[3 * i + r] : force[3 * i + r];
            own[WIDE * r + 3] = part * f;
        }
    }
    put_together(carry, n);
    double largest = 0.0, innovation[3][MOST_TICKS];
    Shown shown;
    memcpy(drawn, last, sizeof drawn);
    for (Size i = 0; i < n; i++) {
        times(turn[i], 3, drawn, WIDE, WIDE, states, WIDE);
        if (i < first)
            memset(states, 0, sizeof states);
        draw(carry[i], last, drawn);
        for (int r = 0; r < 3; r++) {
            double gravity = g * states[WIDE * r], answer[3];
            for (int c = 0; c < 3; c++) {
                answer[c] = (r == c) - states[WIDE * r + 1 + c];
                shown.answer[6 * r + c][i] = answer[c];
                shown.answer[6 * r + 3 + c][i] = states[WIDE * r + 4 + c];
                largest = larger(largest, fabs(answer[c]));
            }
            double answered = answer[0] * bias[0] + answer[1] * bias[1] + answer[2] * bias[2];
            lone[3 * i + r] = force[3 * i + r] - gravity - answered;
            if (has_motion) {
                innovation[r][i] = force[3 * i + r] - motion[3 * i + r] - gravity;
                shown.left[r][i] = innovation[r][i] - answered;
            }
        }
    }
    for (int r = 0; r < 3; r++) {
        sums[r] = has_motion ? sum_of(shown.left[r], n, 1) : 0.0;
        sums[4 + r] = states[WIDE * r];
    }
    if (has_motion && weighed) {
        double noise2[MOST_TICKS], unexplained[3][MOST_TICKS];
        for (Size i = 0; i < n; i++) {
            noise2[i] = number[NOISE2] + number[SHARE2] * square_of(motion + 3 * i);
            double v[3] = {innovation[0][i], innovation[1][i], innovation[2][i]};
            double weight = (learn[i] ? 1.0 : 0.0) / noise2[i];
            shown.weight[i] = weight / larger(sqrt(square_of(v)) / number[LARGE], 1.0);
        }
        memcpy(unexplained, shown.left, sizeof unexplained);
        memcpy(shown.left, innovation, sizeof innovation);
        weigh(&shown, n, 3, of_bias);
        memcpy(shown.left, unexplained, sizeof unexplained);
        for (Size i = 0; i < n; i++) {
            double v[3] = {unexplained[0][i], unexplained[1][i], unexplained[2][i]};
            double weight = (use[i] && ok_rate[i] ? 1.0 : 0.0) / noise2[i];
            shown.weight[i] = weight / larger(sqrt(square_of(v)) / number[LARGE_STEP], 1.0);
        }
        weigh(&shown, n, 6, of_steps);
    }
    sums[3] = largest;
    memcpy(last, drawn, sizeof drawn);
    return leave(&a, raised());
}

enum { STEP_AGES = 10, HISTORY = 96 };

/* Take a block's sums for each candidate, as `GravityStepDetector.add` does. */
KERNEL long add_steps(PyObject *start_, PyObject *score_, PyObject *information_,
                      PyObject *before_, PyObject *sums_, PyObject *end_)
{
    Arrays a = {0};
    double *start = doubles_out(&a, start_, SHAPE(STEP_AGES, 3, 3));
    double *score = doubles_out(&a, score_, SHAPE(STEP_AGES, 3));
    double *information = doubles_out(&a, information_, SHAPE(STEP_AGES, 3, 3));
    const double *before = doubles(&a, before_, SHAPE(3, 3));
    const double *sums = doubles(&a, sums_, SHAPE(7, 6));
    const double *end = doubles(&a, end_, SHAPE(3, 3));
    if (a.failed)
        return leave(&a, -1);
    begin();
    memmove(start + 9, start, (STEP_AGES - 1) * 9 * sizeof *start);
    memmove(score + 3, score, (STEP_AGES - 1) * 3 * sizeof *score);
    memmove(information + 9, information, (STEP_AGES - 1) * 9 * sizeof *information);
    memcpy(start, before, 9 * sizeof *start);
    memset(score, 0, 3 * sizeof *score);
    memset(information, 0, 9 * sizeof *information);
    for (int age = 0; age < STEP_AGES; age++) {
        double *s = start + 9 * age, turned[9], both[9], inner[9], square[9], moved[9];
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                turned[3 * i + j] = s[3 * j + i];
        times(sums + 3, 6, s, 3, 3, both, 3);
        times(sums + 3 * 6 + 3, 6, s, 3, 3, inner, 3);
        times(turned, 3, inner, 3, 3, square, 3);
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                double *own = &information[9 * age + 3 * i + j];
                *own += sums[6 * i + j] + both[3 * i + j] + both[3 * j + i];
                *own += square[3 * i + j];
            }
        const double *left = sums + 6 * 6 + 3;
        for (int i = 0; i < 3; i++)
            score[3 * age + i] += sums[6 * 6 + i] + (turned[3 * i] * left[0] +
                                                     turned[3 * i + 1] * left[1] +
                                                     turned[3 * i + 2] * left[2]);
        times(end, 3, s, 3, 3, moved, 3);
        memcpy(s, moved, sizeof moved);
    }
    return leave(&a, raised());
}

enum Sizes { PRIOR, GRAVITY2, OTHER_AXIS, PART, LEAST_SIZE, IS_KEPT, SIZES };

/* How large a step is at each candidate, and how far it stands out; as `GravityStepDetector.found`.

   walked: (2,) of the vertical, ahead and aside. square: (AGES, 2) the usual, which learns. both:
   (HISTORY, 2, 2) of the blocks gone by, from `first` blocks ago on. found: age, axis, size and
   deviations of the one that stands out most, and how far. */
KERNEL long find_step(PyObject *R_, PyObject *score_, PyObject *information_, PyObject *walked_,
                      PyObject *numbers_, long ages, long first, PyObject *square_, PyObject *both_,
                      PyObject *found_)
{
    Arrays a = {0};
    const double *R = doubles(&a, R_, SHAPE(3, 3));
    const double *score = doubles(&a, score_, SHAPE(STEP_AGES, 3));
    const double *information = doubles(&a, information_, SHAPE(STEP_AGES, 3, 3));
    const double *walked = doubles(&a, walked_, SHAPE(2));
    const double *number = doubles(&a, numbers_, SHAPE(SIZES));
    double *square = doubles_out(&a, square_, SHAPE(STEP_AGES, 2));
    double *both = doubles_out(&a, both_, SHAPE(HISTORY, 2, 2));
    double *found = doubles_out(&a, found_, SHAPE(5));
    if (a.failed)
        return leave(&a, -1);
    if (ages < 0 || ages > STEP_AGES || first < 1 || first > STEP_AGES)
        return leave(&a, refuse(&a, "candidates beyond those of find_step"));
    begin();
    for (long age = 0; age < ages; age++) {
        const double *own = information + 9 * age;
        double J[2][2], s[2];
        for (int i = 0; i < 2; i++) {
            double row[3];
            for (int k = 0; k < 3; k++)
                row[k] = R[3 * i] * own[k] + R[3 * i + 1] * own[3 + k] + R[3 * i + 2] * own[6 + k];
            for (int j = 0; j < 2; j++)
                J[i][j] = row[0] * R[3 * j] + row[1] * R[3 * j + 1] + row[2] * R[3 * j + 2];
            const double *v = score + 3 * age;
            s[i] = R[3 * i] * v[0] + R[3 * i + 1] * v[1] + R[3 * i + 2] * v[2];
        }
        double ahead = J[0][0] + number[PRIOR], aside = J[1][1] + number[PRIOR];
        double det = ahead * aside - J[0][1] * J[1][0];
        double size[2] = {(aside * s[0] - J[0][1] * s[1]) / det,
                          (ahead * s[1] - J[1][0] * s[0]) / det};
        double usual[2], deviations[2];
        for (int k = 0; k < 2; k++)
            usual[k] = square[2 * age + k] + number[GRAVITY2] * walked[k];
        for (int k = 0; k < 2; k++) {
            deviations[k] = size[k] / sqrt(usual[k] + number[OTHER_AXIS] * usual[1 - k]);
            double *now = &square[2 * age + k], most = 9.0 * *now, seen = size[k] * size[k];
            *now += number[PART] * ((isless(most, seen) ? most : seen) - *now);
        }
        if (age < first - 1)
            continue;
        /* gravity seen to the left: the sensor rolled to the right about x; ahead: about -y */
        double turned[2] = {size[1], -size[0]}, spread[2] = {deviations[1], -deviations[0]};
        for (int k = 0; k < 2; k++) {
            if (number[IS_KEPT] != 0.0) {
                double *kept = both + 4 * age + 2 * k;
                kept[0] = larger(kept[0], spread[k]);
                kept[1] = isless(spread[k], kept[1]) ? spread[k] : kept[1];
            }
            double large = fabs(spread[k]) * (fabs(turned[k]) > number[LEAST_SIZE] ? 1.0 : 0.0);
            if (isgreater(large, found[4])) {
                found[0] = (double)age;
                found[1] = k;
                found[2] = turned[k];
                found[3] = spread[k];
                found[4] = large;
            }
        }
    }
    return leave(&a, raised());
}

/* The largest and the least of what is remembered about so many blocks ago each
   (`GravityStepHistory.near`).

   both: (blocks, 2, 2); ages: (n,) from one on; around: blocks to both sides. out: (n, 2, 2). */
KERNEL long near_steps(PyObject *both_, PyObject *ages_, long around, PyObject *out_)
{
    Arrays a = {0};
    const double *both = doubles(&a, both_, SHAPE(ANY, 2, 2));
    Size blocks = length_of(&a, 0);
    const int64_t *ages = take(&a, ages_, 'q', SHAPE(ANY));
    Size n = length_of(&a, 0);
    double *out = doubles_out(&a, out_, SHAPE(n, 2, 2));
    if (a.failed)
        return leave(&a, -1);
    if (around < 1 || around > blocks)
        return leave(&a, refuse(&a, "more blocks than are remembered"));
    memset(out, 0, (size_t)(4 * n) * sizeof *out);
    for (Size i = 0; i < n; i++) {
        double *own = out + 4 * i;
        if (ages[i] < 0 || ages[i] - 1 - around > blocks)
            continue;
        Size newest = (Size)ages[i] - 1 - around, oldest = (Size)ages[i] - 2 + around;
        newest = newest < 0 ? 0 : newest;
        oldest = oldest > blocks - 1 ? blocks - 1 : oldest;
        for (Size k = newest; k <= oldest; k++)
            for (int axis = 0; axis < 2; axis++) {
                const double *of = both + 4 * k + 2 * axis;
                double *most = own + 2 * axis, *least = most + 1;
                *most = k == newest || of[0] > *most ? of[0] : *most;
                *least = k == newest || of[1] < *least ? of[1] : *least;
            }
    }
    return leave(&a, 0);
}
