/* From which sources the library was built, and in which order it takes sums, so that one of other
   sources or another order is not used. */

#include "numerics.h"

KERNEL unsigned long stamp(void);

unsigned long stamp(void)
{
    return STAMP;
}

/* Sums of terms (n, m) over each row, in pairs, and over each column, one after another. */
KERNEL long sums(PyObject *terms_, PyObject *rows_, PyObject *columns_)
{
    Arrays a = {0};
    const double *terms = doubles(&a, terms_, SHAPE(ANY, ANY));
    Size n = length_of(&a, 0), m = length_of(&a, 1);
    double *rows = doubles_out(&a, rows_, SHAPE(n));
    double *columns = doubles_out(&a, columns_, SHAPE(m));
    if (a.failed)
        return leave(&a, -1);
    memset(columns, 0, (size_t)m * sizeof *columns);
    for (Size i = 0; i < n; i++) {
        rows[i] = sum_of(terms + i * m, m, 1);
        for (Size j = 0; j < m; j++)
            columns[j] += terms[i * m + j];
    }
    return leave(&a, 0);
}
