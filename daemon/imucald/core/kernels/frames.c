/* Frames of one message: their protection. */

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
    OK, SHORT, LONG, CHECKSUM, INVALID, EARLY, REPEATED, REVERSED, JUMP, UNTRUSTED, COPY
};

/* What a message's frames must have (`ProtectionSpec`), as it is handed over. */
enum Spec {
    BYTES, LONGEST, RECOVERY,
    COUNTER_FIRST, COUNTER_LENGTH, COUNTER_BIG, MODULUS, MAX_JUMP,   /* length 0: no counter; jump 0: none stated */
    CRC_BYTES, CRC_POSITION, CRC_WIDTH, CRC_BIG, CRC_FINAL,          /* width 0: no checksum */
    INDEX_FIRST, INDEX_LENGTH, INDEX_BIG,                            /* length 0: one start for all */
    FIXED_FIRST, FIXED_LENGTH, FIXED_BIG, FIXED_VALUE,               /* length 0: none */
    SPEC
};

/* What the next frame is held against (`schedule.Past`); -1 and a time that is NaN: nothing yet. */
enum State {
    LAST_COUNTER, MISSED, DISTRUST, LOST, PHASE, EARLY_FRAMES, EARLY_COUNTER, CHAIN, OWN_EARLY,
    TRIALS, LAST_LENGTH, OVERTAKEN, STATE
};
enum Times { LAST_T, DUE, CYCLE, BEGUN, STEPS, TRIED, EARLY_T, CONTRADICTED, TIMES };
enum Phase { LEARN, TRIAL, IN_FORCE };

/* As in `can.e2e.schedule`. */
#define EARLIEST 0.4
#define AHEAD 0.5
#define CREDIT_S 2.0
#define FADES_S 2.0
#define BATCH 0.03
#define LEARN_S 5.0
#define LEARN_STEPS 50
#define REMEMBERED_S 600.0
#define MOST_EARLY 50
#define OWN 3
#define WAITS 1.5
#define LONGER 4.0
#define MOST_TRIALS 6
#define HELD_S 2.0

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

/* Values of a counter, so that no sum of lost frames leaves 64 bits. */
#define MOST_VALUES ((int64_t)1 << 32)

static unsigned fed(const Crc *c, unsigned crc, const uint8_t *p, Size count)
{
    for (Size k = 0; k < count; k++)
        crc = c->width == 1 ? c->table[crc ^ p[k]]
                            : (crc << 8 & 0xFF00u) ^ c->table[crc >> 8 ^ p[k]];
    return crc;
}

static int is_right(const Crc *c, const uint8_t *row)
{
    Size which = c->index.length ? (Size)bits_of(row, c->index) : 0, end = c->position + c->width;
    unsigned crc = fed(c, c->starts[which], row, c->position);
    crc = fed(c, crc, row + end, c->bytes - end);
    crc = fed(c, crc, c->suffixes + which * c->suffix, c->suffix);
    const uint8_t *own = row + c->position;
    unsigned stored = own[0];
    if (c->width == 2)
        stored = c->is_big ? stored << 8 | own[1] : stored | (unsigned)own[1] << 8;
    return stored == (crc ^ c->final) &&
           (!c->fixed.length || bits_of(row, c->fixed) == c->fixed_value);
}

static void learn(int64_t *state, double *time, double t)
{
    state[PHASE] = LEARN;
    state[EARLY_FRAMES] = state[OWN_EARLY] = 0;
    state[EARLY_COUNTER] = -1;
    time[CYCLE] = time[STEPS] = 0.0;
    time[BEGUN] = t;
}

/* As `Past.go_on`. */
static void go_on(int64_t *state, double *time, double t, double since, double due, int64_t step)
{
    double counts = (double)(step ? step : 1), pause = since - (counts + 1.0) * time[CYCLE];
    due += counts * time[CYCLE] - BATCH * (pause > 0.0 ? pause : 0.0);
    due = due < t ? due : t;
    time[DUE] = due > t - CREDIT_S ? due : t - CREDIT_S;
    state[EARLY_FRAMES] -= step && state[EARLY_FRAMES] > 0;
    if (!step || state[DISTRUST] || since > CREDIT_S) {
        time[BEGUN] += since;
        return;
    }
    time[STEPS] += (double)step;
    double passed = t - time[BEGUN];
    if (state[PHASE] == LEARN) {
        time[DUE] = t;
        time[CYCLE] = passed / time[STEPS];
        if (!(passed >= LEARN_S && time[STEPS] >= LEARN_STEPS))
            return;
        state[PHASE] = TRIAL;
        time[TRIED] = t;
        time[DUE] = t - 0.5 * CREDIT_S;
    }
    time[CYCLE] = passed / time[STEPS];
    if (passed > REMEMBERED_S) {
        time[BEGUN] += 0.5 * passed;
        time[STEPS] *= 0.5;
    }
    double proved = LEARN_STEPS * time[CYCLE];
    proved = proved > LEARN_S ? proved : LEARN_S;
    for (int64_t k = 0; k < state[TRIALS]; k++)
        proved *= LONGER;
    if (state[PHASE] == TRIAL && t - time[TRIED] >= proved)
        state[PHASE] = IN_FORCE;
}

/* As `Past.attribute_early`. */
static void attribute_early(int64_t *state, double *time, double t, int64_t value, int64_t modulus)
{
    if (state[EARLY_COUNTER] < 0)
        return;
    int goes_on = value == (state[CHAIN] + 1) % modulus;
    if (t - time[EARLY_T] > WAITS * time[CYCLE]) {
        state[EARLY_COUNTER] = -1;
        if (++state[OWN_EARLY] >= OWN) {
            state[TRIALS] += state[TRIALS] < MOST_TRIALS;
            learn(state, time, t);
        }
    } else if (value == state[EARLY_COUNTER]) {
        state[EARLY_COUNTER] = -1;
        state[OWN_EARLY] -= !goes_on && state[OWN_EARLY] > 0;
    } else if (goes_on)
        state[CHAIN] = value;
}

/* Counter and time of a frame that is good in itself, as `MessageChecker._sequence`; value: -1, no
   counter; taken: whether the next frame is held against this one. */
static uint8_t sequence(const int64_t *spec, double timeout, int64_t *state, double *time, double t,
                        int64_t value, int *taken)
{
    double since = t - time[LAST_T];
    *taken = 1;
    if (!(since >= 0.0 && since <= timeout)) {
        if (isnan(since) && state[PHASE] != LEARN) {
            double left = LEARN_S - LEARN_STEPS * time[CYCLE];
            time[DUE] = t - 0.5 * CREDIT_S;
            time[BEGUN] = t - time[STEPS] * time[CYCLE];
            time[TRIED] = t - (left > 0.0 ? left : 0.0);
        } else if (since > 0.0) {
            time[DUE] = t - (since < CREDIT_S ? since : CREDIT_S);
            time[BEGUN] += since;
        } else {
            time[DUE] = t;
            learn(state, time, t);
        }
        return OK;
    }
    attribute_early(state, time, t, value, value < 0 ? 1 : spec[MODULUS]);
    double fades = 1.0 - since / FADES_S;
    double due = time[LAST_T] - (time[LAST_T] - time[DUE]) * (fades > 0.0 ? fades : 0.0);
    double earliest = due + EARLIEST * time[CYCLE];
    int is_ahead = earliest > t;
    int64_t distance = 1;
    uint8_t code = OK;
    if (value >= 0) {
        int64_t modulus = spec[MODULUS], most = spec[MAX_JUMP], missed = state[MISSED];
        int64_t step = value - state[LAST_COUNTER];
        step = step < 0 ? step + modulus : step;
        distance = step ? step : modulus;
        int64_t back = most ? modulus - most : modulus / 2 + 1;
        int is_bad = distance > (most ? most : back - 1) + missed;
        if (!most && time[CYCLE] != 0.0) {
            double origin = distance >= back ? time[LAST_T] + EARLIEST * time[CYCLE] : earliest;
            is_ahead = origin + AHEAD * time[CYCLE] * (double)(distance - 1) > t;
            is_bad = is_ahead && (is_bad || state[PHASE] == IN_FORCE);
        }
        if (is_bad && distance > 1)
            code = !step ? REPEATED : step >= back ? REVERSED : JUMP;
    }
    if (is_ahead && state[PHASE] == TRIAL)
        time[TRIED] = t;
    if (earliest > t && state[PHASE] == IN_FORCE) {
        if (state[EARLY_COUNTER] < 0) {
            state[EARLY_COUNTER] = state[CHAIN] = value;
            time[EARLY_T] = t;
        }
        if (++state[EARLY_FRAMES] >= MOST_EARLY * (value < 0 ? 1 : spec[MODULUS]))
            learn(state, time, t);
        *taken = 0;
        return code ? code : EARLY;
    }
    if (code == OK && distance - 1 - state[MISSED] > 0)
        state[LOST] += distance - 1 - state[MISSED];
    go_on(state, time, t, since, due, code == OK ? distance : 0);
    return code;
}

/* Judge frames in order, as `MessageChecker.check` does one by one; codes: of each. */
KERNEL long judge_frames(PyObject *t_, PyObject *data_, PyObject *length_, PyObject *spec_,
                         double timeout, PyObject *table_, PyObject *starts_, PyObject *suffixes_,
                         PyObject *state_, PyObject *time_, PyObject *last_data_,
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
    double *time = doubles_out(&a, time_, SHAPE(TIMES));
    uint8_t *last_data = take_out(&a, last_data_, 'B', SHAPE(2, MOST_BYTES));
    uint8_t *overtaken = last_data ? last_data + MOST_BYTES : NULL;
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
               state[OVERTAKEN] >= 0 && state[OVERTAKEN] <= MOST_BYTES &&
               state[LAST_COUNTER] >= -1 &&
               (!counter.length || state[LAST_COUNTER] < spec[MODULUS]) && spec[MAX_JUMP] >= 0 &&
               spec[MAX_JUMP] <= MOST_VALUES && spec[RECOVERY] >= 0 && state[DISTRUST] >= 0 &&
               state[MISSED] >= 0 && state[MISSED] <= LARGEST_COUNT / 4 && state[LOST] >= 0 &&
               state[PHASE] >= LEARN && state[PHASE] <= IN_FORCE &&
               state[EARLY_FRAMES] >= 0 && state[EARLY_FRAMES] <= MOST_EARLY * MOST_VALUES &&
               state[EARLY_COUNTER] >= -1 && state[EARLY_COUNTER] < MOST_VALUES &&
               state[CHAIN] >= -1 && state[CHAIN] < MOST_VALUES && state[OWN_EARLY] >= 0 &&
               state[OWN_EARLY] <= OWN && state[TRIALS] >= 0 && state[TRIALS] <= MOST_TRIALS &&
               state[LOST] <= LARGEST_COUNT && n <= LARGEST_COUNT / MOST_VALUES;
    for (Size k = 0; good && crc == 1 && k < TABLE; k++)
        good = table[k] < TABLE && (k >= many || starts[k] < TABLE);
    for (Size k = TABLE; good && crc == 1 && k < many; k++)
        good = starts[k] < TABLE;
    if (!good)
        return leave(&a, refuse(&a, "numbers beyond the arrays of judge_frames"));
    for (Size i = 0; i < n; i++) {
        const uint8_t *row = data + i * width;
        uint8_t code = OK;
        if (length[i] < size || width < size)
            code = SHORT;
        else if (length[i] > spec[LONGEST] || length[i] > width)
            code = LONG;
        else if (crc && !is_right(&checksum, row))
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
            if (code == OK && value >= 0 && t[i] == time[LAST_T] &&
                state[LAST_LENGTH] == length[i] && !memcmp(last_data, row, length[i])) {
                codes[i] = COPY;
                state[LAST_LENGTH] = -1;
                continue;
            }
            if (code == OK && (crc || counter.length)) {
                int taken;
                double before = t[i] - time[LAST_T];
                double cycle = time[CYCLE];
                int is_near = before > 0.0 && before <= WAITS * cycle;
                code = sequence(spec, timeout, state, time, t[i], value, &taken);
                int is_soon = code == REPEATED && before <= (1.0 - 0.5 * EARLIEST) * cycle;
                const uint8_t *known = is_soon ? last_data : overtaken;
                int64_t size_known = state[is_soon ? LAST_LENGTH : OVERTAKEN];
                if (is_near && spec[RECOVERY] && value >= 0 && size_known > 0 &&
                    bits_of(known, counter) == (uint64_t)value &&
                    (size_known != length[i] || memcmp(known, row, length[i])))
                    time[CONTRADICTED] = t[i];
                state[OVERTAKEN] = is_near && code == REVERSED && state[LAST_LENGTH] > 0
                                       ? state[LAST_LENGTH] : 0;
                memcpy(overtaken, last_data, (size_t)state[OVERTAKEN]);
                if (taken) {
                    int is_new = value != state[LAST_COUNTER];
                    state[LAST_LENGTH] = is_new ? length[i] : -1;
                    if (is_new && width == 8)
                        memcpy(last_data, row, 8);
                    else if (is_new)
                        memcpy(last_data, row, length[i]);
                    state[LAST_COUNTER] = value;
                    time[LAST_T] = t[i];
                    state[MISSED] = 0;
                }
            }
            if (code == OK && state[DISTRUST]) {
                state[DISTRUST]--;
                codes[i] = UNTRUSTED;
                continue;
            }
            double held = t[i] - time[CONTRADICTED];
            if (code == OK && held >= 0.0 && held < HELD_S) {
                codes[i] = UNTRUSTED;
                continue;
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
