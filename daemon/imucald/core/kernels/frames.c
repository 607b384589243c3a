/* Frames of one message: their protection, and their signals as columns. */

#include "arrays.h"

enum { MOST_BYTES = 64, WORD_BITS = 64, TABLE = 256 };

/* A run of bits (`can.dbc.bits.Field`). */
typedef struct {
    Size first, length;
    int is_big;
} Field;

static int fits(Field field, Size width)
{
    return field.first >= 0 && field.length >= 1 && field.length <= WORD_BITS &&
           field.first <= 8 * MOST_BYTES && field.first + field.length <= 8 * width;
}

/* The bits of a row that is as long as whole words. */
static inline uint64_t bits_of(const uint8_t *row, Field field)
{
    Size at = field.first % WORD_BITS, over = at + field.length - WORD_BITS;
    const uint8_t *p = row + field.first / WORD_BITS * 8;
    uint64_t word, next = 0;
    memcpy(&word, p, 8);
    if (over > 0)
        memcpy(&next, p + 8, 8);
    if (field.is_big) {
        word = __builtin_bswap64(word) << at;
        if (over > 0)
            word |= __builtin_bswap64(next) >> (WORD_BITS - at);
        return word >> (WORD_BITS - field.length);
    }
    word >>= at;
    if (over > 0)
        word |= next << (WORD_BITS - at);
    return word & ~0ull >> (WORD_BITS - field.length);
}

enum Code {
    OK, SHORT, LONG, CHECKSUM, INVALID, TIMEOUT, REPEATED, REVERSED, JUMP, UNTRUSTED, COPY
};

/* What a message's frames must have (`ProtectionSpec`), as it is handed over. */
enum Spec {
    BYTES, LONGEST, RECOVERY,
    COUNTER_FIRST, COUNTER_LENGTH, COUNTER_BIG, MODULUS, MAX_JUMP,   /* length 0: no counter */
    CRC_BYTES, CRC_POSITION, CRC_WIDTH, CRC_BIG, CRC_FINAL,          /* width 0: no checksum */
    INDEX_FIRST, INDEX_LENGTH, INDEX_BIG,                            /* length 0: one start for all */
    FIXED_FIRST, FIXED_LENGTH, FIXED_BIG, FIXED_VALUE,               /* length 0: none */
    SPEC
};

/* What the next frame is held against; -1 and a time that is NaN: nothing yet. */
enum State { LAST_COUNTER, MISSED, DISTRUST, LOST, LAST_LENGTH, STATE };

/* A message's checksum (`ChecksumSpec`). */
typedef struct {
    Size bytes, position, width, suffix;
    unsigned final;
    int is_big;
    Field index, fixed;
    uint64_t fixed_value;
    const uint16_t *table, *starts;
    const uint8_t *suffixes;
} Crc;

enum { TOGETHER = 4 };

/* Values of a counter, so that no sum of lost frames leaves 64 bits. */
#define MOST_VALUES ((int64_t)1 << 32)

/* One byte more of each frame's checksum: of 8 bits, and of 16. */
#define FEED_8(i) crc[i] = c->table[crc[i] ^ p[i][k]]
#define FEED_16(i) crc[i] = (crc[i] << 8 & 0xFF00u) ^ c->table[crc[i] >> 8 ^ p[i][k]]

static inline void feed(const Crc *c, unsigned *crc, const uint8_t *const *p, Size from, Size to)
{
    if (c->width == 1)
        for (Size k = from; k < to; k++) {
            FEED_8(0);
            FEED_8(1);
            FEED_8(2);
            FEED_8(3);
        }
    else
        for (Size k = from; k < to; k++) {
            FEED_16(0);
            FEED_16(1);
            FEED_16(2);
            FEED_16(3);
        }
}

/* Whether frames are right; some at once, as each byte of a frame waits for the one before. */
static void are_right(const Crc *c, const uint8_t *const *rows, uint8_t *right)
{
    unsigned crc[TOGETHER];
    const uint8_t *last[TOGETHER];
    for (int i = 0; i < TOGETHER; i++) {
        Size which = c->index.length ? (Size)bits_of(rows[i], c->index) : 0;
        crc[i] = c->starts[which];
        last[i] = c->suffixes + which * c->suffix;
    }
    feed(c, crc, rows, 0, c->position);
    feed(c, crc, rows, c->position + c->width, c->bytes);
    feed(c, crc, last, 0, c->suffix);
    for (int i = 0; i < TOGETHER; i++) {
        const uint8_t *own = rows[i] + c->position;
        unsigned stored = own[0];
        if (c->width == 2)
            stored = c->is_big ? stored << 8 | own[1] : stored | (unsigned)own[1] << 8;
        right[i] = stored == (crc[i] ^ c->final) &&
                   (!c->fixed.length || bits_of(rows[i], c->fixed) == c->fixed_value);
    }
}

/* Judge frames in order, as `MessageChecker.check` does one by one; codes: of each. */
KERNEL long judge_frames(PyObject *t_, PyObject *data_, PyObject *length_, PyObject *spec_,
                         double timeout, PyObject *table_, PyObject *starts_, PyObject *suffixes_,
                         PyObject *state_, PyObject *last_t_, PyObject *last_data_,
                         PyObject *codes_)
{
    Arrays a = {0};
    const double *t = doubles(&a, t_, SHAPE(ANY));
    Size n = length_of(&a, 0);
    const uint8_t *data = take(&a, data_, 'B', SHAPE(n, ANY));
    Size width = length_of(&a, 1);
    const uint8_t *length = take(&a, length_, 'B', SHAPE(n));
    const int64_t *spec = take(&a, spec_, 'q', SHAPE(SPEC));
    const uint16_t *table = take(&a, table_, 'H', SHAPE(TABLE));
    const uint16_t *starts = take(&a, starts_, 'H', SHAPE(ANY));
    Size many = length_of(&a, 0);
    const uint8_t *suffixes = take(&a, suffixes_, 'B', SHAPE(many, ANY));
    Size suffix = length_of(&a, 1);
    int64_t *state = take_out(&a, state_, 'q', SHAPE(STATE));
    double *last_t = doubles_out(&a, last_t_, SHAPE(1));
    uint8_t *last_data = take_out(&a, last_data_, 'B', SHAPE(MOST_BYTES));
    uint8_t *codes = take_out(&a, codes_, 'B', SHAPE(n));
    if (a.failed)
        return leave(&a, -1);
    Field counter = {spec[COUNTER_FIRST], spec[COUNTER_LENGTH], spec[COUNTER_BIG] != 0};
    Field index = {spec[INDEX_FIRST], spec[INDEX_LENGTH], spec[INDEX_BIG] != 0};
    Field fixed = {spec[FIXED_FIRST], spec[FIXED_LENGTH], spec[FIXED_BIG] != 0};
    Size size = (Size)spec[BYTES], crc = (Size)spec[CRC_WIDTH];
    Crc checksum = {(Size)spec[CRC_BYTES], (Size)spec[CRC_POSITION], crc, suffix,
                    (unsigned)spec[CRC_FINAL], spec[CRC_BIG] != 0, index, fixed,
                    (uint64_t)spec[FIXED_VALUE], table, starts, suffixes};
    /* a frame of the message's length holds all of these; shorter ones are not looked at */
    int good = size >= 0 && size <= MOST_BYTES && width <= MOST_BYTES && width % 8 == 0 &&
               (!counter.length || (fits(counter, size) && spec[MODULUS] >= 1 &&
                                    spec[MODULUS] <= MOST_VALUES)) &&
               (!index.length || (fits(index, size) && index.length < 16 &&
                                  many >= (Size)1 << index.length)) &&
               (!fixed.length || fits(fixed, size)) &&
               (!crc || ((crc == 1 || crc == 2) && many >= 1 && spec[CRC_BYTES] >= crc &&
                         spec[CRC_BYTES] <= size && spec[CRC_POSITION] >= 0 &&
                         spec[CRC_POSITION] <= spec[CRC_BYTES] - crc)) &&
               state[LAST_LENGTH] >= -1 && state[LAST_LENGTH] <= MOST_BYTES &&
               state[LAST_COUNTER] >= -1 &&
               (!counter.length || state[LAST_COUNTER] < spec[MODULUS]) && spec[MAX_JUMP] >= 0 &&
               spec[MAX_JUMP] <= MOST_VALUES && spec[RECOVERY] >= 0 && state[DISTRUST] >= 0 &&
               state[MISSED] >= 0 && state[MISSED] <= LARGEST_COUNT / 4 && state[LOST] >= 0 &&
               state[LOST] <= LARGEST_COUNT && n <= LARGEST_COUNT / MOST_VALUES;
    for (Size k = 0; good && crc == 1 && k < TABLE; k++)
        good = table[k] < TABLE && (k >= many || starts[k] < TABLE);
    for (Size k = TABLE; good && crc == 1 && k < many; k++)
        good = starts[k] < TABLE;
    if (!good)
        return leave(&a, refuse(&a, "numbers beyond the arrays of judge_frames"));
    uint8_t right[TOGETHER] = {1, 1, 1, 1};
    for (Size i = 0; i < n; i++) {
        const uint8_t *row = data + i * width;
        uint8_t code = OK;
        if (crc && width >= size && i % TOGETHER == 0) {
            const uint8_t *rows[TOGETHER];
            for (Size k = 0; k < TOGETHER; k++)
                rows[k] = data + (i + k < n ? i + k : i) * width;
            are_right(&checksum, rows, right);
        }
        if (length[i] < size || width < size)
            code = SHORT;
        else if (length[i] > spec[LONGEST] || length[i] > width)
            code = LONG;
        else if (!right[i % TOGETHER])
            code = CHECKSUM;
        else {
            int64_t value = -1;
            if (counter.length) {
                uint64_t bits = bits_of(row, counter);
                if (bits >= (uint64_t)spec[MODULUS])
                    code = INVALID;
                else
                    value = (int64_t)bits;
            }
            if (code == OK && value >= 0 && t[i] == *last_t && state[LAST_LENGTH] == length[i] &&
                !memcmp(last_data, row, length[i])) {
                codes[i] = COPY;
                state[LAST_LENGTH] = -1;
                continue;
            }
            if (code == OK) {
                if (value >= 0) {
                    int is_new = value != state[LAST_COUNTER];
                    state[LAST_LENGTH] = is_new ? length[i] : -1;
                    if (is_new && width == 8)
                        memcpy(last_data, row, 8);
                    else if (is_new)
                        memcpy(last_data, row, length[i]);
                    int64_t last = state[LAST_COUNTER], missed = state[MISSED];
                    state[LAST_COUNTER] = value;
                    if (t[i] - *last_t > timeout)
                        code = TIMEOUT;
                    else if (last >= 0) {
                        int64_t step = value - last;
                        step = step < 0 ? step + spec[MODULUS] : step;
                        int64_t distance = step ? step : spec[MODULUS];
                        if (distance <= spec[MAX_JUMP] + missed) {
                            if (distance - 1 - missed > 0)
                                state[LOST] += distance - 1 - missed;
                        } else if (!step)
                            code = REPEATED;
                        else
                            code = step >= spec[MODULUS] - spec[MAX_JUMP] ? REVERSED : JUMP;
                    }
                } else if (t[i] - *last_t > timeout)
                    code = TIMEOUT;
                *last_t = t[i];
                state[MISSED] = 0;
                if (code == OK && state[DISTRUST]) {
                    state[DISTRUST]--;
                    codes[i] = UNTRUSTED;
                    continue;
                }
            }
        }
        codes[i] = code;
        if (code != OK) {
            state[DISTRUST] = spec[RECOVERY];
            if (code <= INVALID)
                state[MISSED]++;
        }
    }
    return leave(&a, 0);
}

enum Number { SCALE, SHIFT, ADDED, FACTOR, UNIT_ADDED, SIGN, LOW, HIGH, LIMIT, RAIL_LOW, RAIL_HIGH,
              ON_ABOVE, NUMBERS };
enum Whole { FIELD_FIRST, FIELD_LENGTH, FIELD_BIG, IS_SIGNED, IS_SCALED, FRAME_BYTES, KIND, WHOLES };
enum Kind { QUANTITY, NOT_ZERO, ABOVE, AMONG };
enum Refused { TAKEN, NOT_AVAILABLE, NOT_FINITE, SATURATED, OUT_OF_RANGE };

/* A signal of frames, and where its values go. */
typedef struct {
    Size n, width, refusals, on;
    const uint8_t *data, *length;
    Field field;
    const int64_t *whole, *refused;
    const double *number, *on_values;
    double *values;
    int8_t *codes;
} Signal;

/* Always inlined with what is known of a signal, so that no frame asks for it again. */
static inline __attribute__((always_inline)) void take_signal(const Signal *s, int is_signed,
                                                              int is_scaled, int kind)
{
    Size n = s->n, width = s->width, refusals = s->refusals, on = s->on;
    Size unused = WORD_BITS - s->field.length, least = (Size)s->whole[FRAME_BYTES];
    const uint8_t *data = s->data, *length = s->length;
    const int64_t *refused = s->refused;
    const double *on_values = s->on_values;
    double *values = s->values, above = s->number[ON_ABOVE];
    int8_t *codes = s->codes;
    Field field = s->field;
    double scale = s->number[SCALE], shift = s->number[SHIFT], added = s->number[ADDED];
    double factor = s->number[FACTOR], unit_added = s->number[UNIT_ADDED], sign = s->number[SIGN];
    double low = s->number[LOW], high = s->number[HIGH], limit = s->number[LIMIT];
    double rail_low = s->number[RAIL_LOW], rail_high = s->number[RAIL_HIGH];
    for (Size i = 0; i < n; i++) {
        int64_t raw = (int64_t)bits_of(data + i * width, field);
        if (is_signed)
            raw = (int64_t)((uint64_t)raw << unused) >> unused;
        double physical = (double)raw;
        if (is_scaled) {
            physical *= scale;
            physical += shift;
        }
        if (length[i] < least)
            physical = NAN;
        double value = physical;
        if (kind == QUANTITY)
            value = ((physical + added) * factor + unit_added) * sign;
        else if (kind == NOT_ZERO)
            value = physical != 0.0;
        else if (kind == ABOVE)
            value = physical > above;
        else {
            value = 0.0;
            for (Size k = 0; k < on; k++)
                if (physical == on_values[k])
                    value = 1.0;
        }
        int is_refused = 0;
        for (Size k = 0; k < refusals; k++)
            is_refused |= raw == refused[k];
        /* a number that is not one fails every comparison */
        int fits = (low <= physical) & (physical <= high) & (-limit <= value) & (value <= limit);
        int is_between = (rail_low < physical) & (physical < rail_high);
        int is_finite = physical - physical == 0.0;
        values[i] = value;
        if (is_refused || !(fits & is_between & is_finite)) {
            values[i] = NAN;
            if (!codes[i])
                codes[i] = is_refused ? NOT_AVAILABLE : !is_finite ? NOT_FINITE
                            : !is_between ? SATURATED : OUT_OF_RANGE;
        }
    }
}

/* One signal of frames in SI, as `Scaling.column` and then `Conversion.array` make it of them.

   values: NaN where a number is refused; codes: why, where none of the signals before was. */
KERNEL long signal_column(PyObject *data_, PyObject *length_, PyObject *wholes_, PyObject *numbers_,
                          PyObject *not_available_, PyObject *on_values_, PyObject *values_,
                          PyObject *codes_)
{
    Arrays a = {0};
    Signal s;
    s.data = take(&a, data_, 'B', SHAPE(ANY, ANY));
    s.n = length_of(&a, 0);
    s.width = length_of(&a, 1);
    s.length = take(&a, length_, 'B', SHAPE(s.n));
    s.whole = take(&a, wholes_, 'q', SHAPE(WHOLES));
    s.number = doubles(&a, numbers_, SHAPE(NUMBERS));
    s.refused = take(&a, not_available_, 'q', SHAPE(ANY));
    s.refusals = length_of(&a, 0);
    s.on_values = doubles(&a, on_values_, SHAPE(ANY));
    s.on = length_of(&a, 0);
    s.values = doubles_out(&a, values_, SHAPE(s.n));
    s.codes = take_out(&a, codes_, 'b', SHAPE(s.n));
    if (a.failed)
        return leave(&a, -1);
    s.field = (Field){s.whole[FIELD_FIRST], s.whole[FIELD_LENGTH], s.whole[FIELD_BIG] != 0};
    if (!fits(s.field, s.width) || s.width % 8)
        return leave(&a, refuse(&a, "a signal beyond its frame"));
    int is_signed = s.whole[IS_SIGNED] != 0, is_scaled = s.whole[IS_SCALED] != 0;
    if (s.whole[KIND] == QUANTITY && is_signed)
        take_signal(&s, 1, is_scaled, QUANTITY);
    else if (s.whole[KIND] == QUANTITY)
        take_signal(&s, 0, is_scaled, QUANTITY);
    else
        take_signal(&s, is_signed, is_scaled, (int)s.whole[KIND]);
    return leave(&a, 0);
}
