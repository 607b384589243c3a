/* What kernels of numbers share: sums in numpy's order, and what no arithmetic bears. */

#ifndef IMUCALD_NUMERICS_H
#define IMUCALD_NUMERICS_H

#include <fenv.h>

#include "arrays.h"

enum { OVERFLOWED = 1, INVALID_NUMBER = 2, DIVIDED_BY_ZERO = 4 };

/* numpy looks whether a number overflowed or came from nothing, and warns or raises; so a kernel
   says it, and its caller has numpy do so. */
static inline void begin(void)
{
    feclearexcept(FE_OVERFLOW | FE_INVALID | FE_DIVBYZERO);
}

static inline long raised(void)
{
    int found = fetestexcept(FE_OVERFLOW | FE_INVALID | FE_DIVBYZERO);
    return (found & FE_OVERFLOW ? OVERFLOWED : 0) | (found & FE_INVALID ? INVALID_NUMBER : 0) |
           (found & FE_DIVBYZERO ? DIVIDED_BY_ZERO : 0);
}

/* As numpy.add.reduce of so many numbers, some places apart: in pairs. */
static inline double sum_of(const double *x, Size n, Size apart)
{
    if (n < 8) {
        double sum = 0.0;
        for (Size k = 0; k < n; k++)
            sum += x[k * apart];
        return sum;
    }
    if (n <= 128) {
        double r[8];
        Size i;
        for (i = 0; i < 8; i++)
            r[i] = x[i * apart];
        for (i = 8; i < n - n % 8; i += 8)
            for (int k = 0; k < 8; k++)
                r[k] += x[(i + k) * apart];
        double sum = ((r[0] + r[1]) + (r[2] + r[3])) + ((r[4] + r[5]) + (r[6] + r[7]));
        for (; i < n; i++)
            sum += x[i * apart];
        return sum;
    }
    Size half = n / 2;
    half -= half % 8;
    return sum_of(x, half, apart) + sum_of(x + half * apart, n - half, apart);
}

/* As numpy.add.reduceat of so many: the first, and the sum of the others. */
static inline double piece_of(const double *x, Size n, Size apart)
{
    return n == 1 ? x[0] : x[0] + sum_of(x + apart, n - 1, apart);
}

static inline double larger(double x, double y)
{
    return isless(x, y) ? y : x;
}

#endif
