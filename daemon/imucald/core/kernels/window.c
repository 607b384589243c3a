/* The window of force and motion (`mount.gravity_observer`, `mount.evidence_spectra`). */

#include "numerics.h"

enum { MEASURED = 20, MOST_TICKS = 256, TAKEN = 7 };
enum { FORCE = 0, DVDT = 3, LATERAL = 4, SPEED_RATE = 5, RATE = 8, DVDT_YAW = 14, LATERAL_YAW = 15 };
static const int TERMS[TAKEN] = {11, 12, 13, 16, 17, 18, 19};

/* What a first-order lag leaves of motion, as `gravity_observer.remaining` has it.

   x: (n,) of one term, step: (n,) between two of them. state: what the lag had taken up before. */
static void remaining(double *x, Size step, const double *gain, Size n, double *state)
{
    double part[MOST_TICKS], decay[MOST_TICKS];
    for (Size k = 0; k < n; k++) {
        part[k] = gain[k] * x[k * step];
        decay[k] = 1.0 - gain[k];
    }
    for (Size apart = 1; apart < n; apart *= 2)
        for (Size k = n - 1; k >= apart; k--) {
            part[k] += decay[k] * part[k - apart];
            decay[k] *= decay[k - apart];
        }
    double before = *state;
    for (Size k = 0; k < n; k++) {
        x[k * step] -= before;
        before = decay[k] * *state + part[k];
    }
    *state = before;
}

/* Push a block of n ticks into a window, the oldest out.

   values: (W, MEASURED), mask: (W,). lone: (n, 3) force without gravity; learn: (n,) the new mask. use:
   (n,) where the vertical followed the force, by `pull`. state: (TAKEN,) what it had taken up. */
KERNEL long push_window(PyObject *values_, PyObject *mask_, PyObject *lone_, PyObject *accel_,
                        PyObject *turn_, PyObject *yaw_rate_, PyObject *speed_, PyObject *rate_,
                        PyObject *ok_rate_, PyObject *learn_, PyObject *use_, double pull,
                        PyObject *state_)
{
    Arrays a = {0};
    double *values = doubles_out(&a, values_, SHAPE(ANY, MEASURED));
    Size window = length_of(&a, 0);
    uint8_t *mask = take_out(&a, mask_, '?', SHAPE(window));
    const double *lone = doubles(&a, lone_, SHAPE(ANY, 3));
    Size n = length_of(&a, 0);
    const double *accel = doubles(&a, accel_, SHAPE(n));
    const double *turn = doubles(&a, turn_, SHAPE(n));
    const double *yaw_rate = doubles(&a, yaw_rate_, SHAPE(n));
    const double *speed = doubles(&a, speed_, SHAPE(n));
    const double *rate = doubles(&a, rate_, SHAPE(n, 3));
    const uint8_t *ok_rate = flags_in(&a, ok_rate_, SHAPE(n));
    const uint8_t *learn = flags_in(&a, learn_, SHAPE(n));
    const uint8_t *use = flags_in(&a, use_, SHAPE(n));
    double *state = doubles_out(&a, state_, SHAPE(TAKEN));
    if (a.failed)
        return leave(&a, -1);
    if (n < 1 || n > MOST_TICKS || n > window)
        return leave(&a, refuse(&a, "more ticks than a window has"));
    begin();
    Size kept = window - n;
    memmove(values, values + n * MEASURED, (size_t)(kept * MEASURED) * sizeof *values);
    memmove(mask, mask + n, (size_t)kept);
    memcpy(mask + kept, learn, (size_t)n);
    double *new = values + kept * MEASURED, gain[MOST_TICKS];
    for (Size k = 0; k < n; k++) {
        double *row = new + k * MEASURED, x = accel[k], y = turn[k], r = yaw_rate[k];
        gain[k] = use[k] ? pull : 0.0;
        memcpy(row + FORCE, lone + 3 * k, 3 * sizeof *row);
        row[DVDT] = x;
        row[LATERAL] = y;
        for (int i = 0; i < 3; i++) {
            double own = rate[3 * k + i] * (ok_rate[k] ? 1.0 : 0.0);
            row[RATE + i] = own;
            row[SPEED_RATE + i] = own * speed[k];
        }
        double terms[TAKEN] = {x * x, y * y, r * r, x * fabs(x), x * y, x, y};
        for (int i = 0; i < TAKEN; i++)
            row[TERMS[i]] = terms[i];
        row[DVDT_YAW] = x * r;
        row[LATERAL_YAW] = y * r;
    }
    for (int i = 0; i < TAKEN; i++)
        remaining(new + TERMS[i], MEASURED, gain, n, &state[i]);
    return leave(&a, raised());
}

/* Signals of a window with masked ticks, and maybe the mean, taken out, and tapered, as `spectra` needs
   them; out: (W, k). */
KERNEL long tapered(PyObject *signals_, PyObject *mask_, PyObject *taper_, long keeps_mean,
                    PyObject *out_)
{
    Arrays a = {0};
    const double *signals = doubles(&a, signals_, SHAPE(ANY, ANY));
    Size n = length_of(&a, 0), columns = length_of(&a, 1);
    const uint8_t *mask = flags_in(&a, mask_, SHAPE(n));
    const double *taper = doubles(&a, taper_, SHAPE(n));
    double *out = doubles_out(&a, out_, SHAPE(n, columns));
    if (a.failed)
        return leave(&a, -1);
    if (columns > MEASURED)
        return leave(&a, refuse(&a, "more signals than a window has"));
    begin();
    double mean[MEASURED] = {0}, count = 0.0;
    for (Size k = 0; !keeps_mean && k < n; k++) {
        count += mask[k] ? 1.0 : 0.0;
        for (Size c = 0; c < columns; c++)
            mean[c] += mask[k] ? signals[k * columns + c] : 0.0;
    }
    for (Size c = 0; !keeps_mean && c < columns; c++)
        mean[c] /= count > 1.0 ? count : 1.0;
    for (Size k = 0; k < n; k++)
        for (Size c = 0; c < columns; c++) {
            double x = mask[k] ? signals[k * columns + c] - mean[c] : 0.0;
            out[k * columns + c] = x * taper[k];
        }
    return leave(&a, raised());
}
