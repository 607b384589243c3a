/* What a kernel sees of Python: numpy's arrays, by the buffer protocol.

Python.h is not needed: the few names below are part of its stable interface since 3.11, and do not
change. A kernel takes its arrays first, each with the kind and the shape that it must have, and
returns where one has another: no place is read or written that was not checked here. */

#ifndef IMUCALD_ARRAYS_H
#define IMUCALD_ARRAYS_H

#include <float.h>
#include <limits.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if FLT_EVAL_METHOD != 0
#error "sums must be of doubles, as numpy's are"
#endif
#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "bytes are read as little-endian words"
#endif
#if LONG_MAX != INT64_MAX || PTRDIFF_MAX != INT64_MAX
#error "places are handed over as numbers of 64 bits"
#endif

/* No count that is carried on is larger. */
#define LARGEST_COUNT (INT64_MAX / 2)

#define KERNEL __attribute__((visibility("default")))

typedef ptrdiff_t Size;
typedef struct _object PyObject;

typedef struct {
    void *buf;
    PyObject *obj;
    Size len, itemsize;
    int readonly, ndim;
    char *format;
    Size *shape, *strides, *suboffsets;
    void *internal;
} Py_buffer;

extern int PyObject_GetBuffer(PyObject *, Py_buffer *, int);
extern void PyBuffer_Release(Py_buffer *);
extern void PyErr_SetString(PyObject *, const char *);
extern PyObject *PyExc_ValueError;

enum { WRITABLE = 0x1, FORMAT = 0x4, STRIDES = 0x18, C_ORDER = 0x38 };
enum { MOST_ARRAYS = 32, MOST_DIMENSIONS = 4, ANY = -1, END = -2 };

/* The arrays that a kernel has taken, and copies of some; all are given back at its end. */
typedef struct {
    Py_buffer taken[MOST_ARRAYS];
    void *copies[MOST_ARRAYS];
    int count, copied, failed;
} Arrays;

#define SHAPE(...) ((const Size[]){__VA_ARGS__, END})

static inline int is_of_kind(const Py_buffer *view, char kind)
{
    const char *format = view->format ? view->format : "B";
    if (format[0] == '\0' || format[1])
        return 0;
    if (kind == 'q') /* numpy says l or q for int64 */
        return (format[0] == 'l' || format[0] == 'q') && view->itemsize == 8;
    if (kind == 'I')
        return (format[0] == 'I' || format[0] == 'L') && view->itemsize == 4;
    return format[0] == kind;
}

static inline Py_buffer *take_view(Arrays *a, PyObject *object, char kind, const Size *shape,
                                   int flags)
{
    if (a->failed)
        return NULL;
    Py_buffer *view = &a->taken[a->count];
    if (a->count == MOST_ARRAYS || PyObject_GetBuffer(object, view, flags | FORMAT)) {
        a->failed = 1;
        return NULL;
    }
    a->count++;
    int dims = 0, fits = is_of_kind(view, kind);
    for (; shape[dims] != END; dims++)
        fits = fits && dims < view->ndim && (shape[dims] == ANY || shape[dims] == view->shape[dims]);
    if (!fits || dims != view->ndim) {
        PyErr_SetString(PyExc_ValueError, "an array has another type or shape than its kernel needs");
        a->failed = 1;
        return NULL;
    }
    return view;
}

/* The first element of an array that is written to, and must lie row by row; NULL where it does not
   fit. */
static inline void *take_out(Arrays *a, PyObject *object, char kind, const Size *shape)
{
    Py_buffer *view = take_view(a, object, kind, shape, C_ORDER | WRITABLE);
    return view ? view->buf : NULL;
}

/* The same of one that is only read: row by row, in a copy where it lies otherwise. */
static inline const void *take(Arrays *a, PyObject *object, char kind, const Size *shape)
{
    Py_buffer *view = take_view(a, object, kind, shape, STRIDES);
    if (!view)
        return NULL;
    Size apart = view->itemsize, places[MOST_DIMENSIONS] = {0};
    int lies = 1;
    for (int d = view->ndim - 1; d >= 0; d--) {
        lies = lies && (view->shape[d] == 1 || view->strides[d] == apart);
        apart *= view->shape[d];
    }
    if (lies || !view->len)
        return view->buf;
    char *copy = view->ndim > MOST_DIMENSIONS ? NULL : malloc((size_t)view->len);
    if (!copy) {
        PyErr_SetString(PyExc_ValueError, "no room for a copy of an array");
        a->failed = 1;
        return NULL;
    }
    a->copies[a->copied++] = copy;
    int inner = view->ndim - 1; /* runs of it are copied at once where they lie together */
    Size run = view->strides[inner] == view->itemsize ? view->shape[inner] : 1;
    for (Size at = 0; at < view->len; at += run * view->itemsize) {
        const char *from = view->buf;
        for (int d = 0; d < view->ndim; d++)
            from += places[d] * view->strides[d];
        memcpy(copy + at, from, (size_t)(run * view->itemsize));
        places[inner] += run - 1;
        for (int d = inner; d >= 0 && ++places[d] == view->shape[d]; d--)
            places[d] = 0;
    }
    return copy;
}

static inline const double *doubles(Arrays *a, PyObject *object, const Size *shape)
{
    return take(a, object, 'd', shape);
}

static inline double *doubles_out(Arrays *a, PyObject *object, const Size *shape)
{
    return take_out(a, object, 'd', shape);
}

/* What a kernel returns where numbers that it was given lead beyond its arrays. */
static inline long refuse(Arrays *a, const char *why)
{
    PyErr_SetString(PyExc_ValueError, why);
    a->failed = 1;
    return -1;
}

/* The length of the array that was taken last, along one of its dimensions. */
static inline Size length_of(const Arrays *a, int dimension)
{
    return a->failed ? 0 : a->taken[a->count - 1].shape[dimension];
}

static inline long leave(Arrays *a, long result)
{
    while (a->copied)
        free(a->copies[--a->copied]);
    while (a->count)
        PyBuffer_Release(&a->taken[--a->count]);
    return a->failed ? -1 : result;
}

#endif
