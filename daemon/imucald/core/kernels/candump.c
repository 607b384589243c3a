/* Lines of candump text to columns of frames, in one pass.

A line is taken only where it is a data frame to the letter of the grammar (`candump_line`); every
other one is handed back as odd, and the strict reader decides. The text is whatever a file holds:
all that is read of a line lies before its newline, or in the padding behind the text. */

#include "arrays.h"

enum { PADDING = 16, NAME = 32, WORD = 8 };
enum { MOST_SECONDS = 19, MOST_FRACTION = 19, MOST_GAP = 32, MOST_DIGITS = 18 };
enum { EXTENDED_DIGITS = 8, STANDARD_DIGITS = 3, CLASSIC = 8, LONGEST = 64, VERDICTS = 4096 };
#define EFF_FLAG 0x80000000u
#define EFF_MASK 0x1FFFFFFFu
#define EXACT (1ull << 53)

enum Result { DONE, NEW_CHANNEL, ODD_IS_FULL, LONG_FRAME, FRAMES_FULL };
enum Counts { PLACE, NUMBER, FRAMES, ODD, AS_TEXT, ANY_FD, COUNTS };

static const double POWERS[MOST_DIGITS + 1] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,
                                               1e7,  1e8,  1e9,  1e10, 1e11, 1e12, 1e13,
                                               1e14, 1e15, 1e16, 1e17, 1e18};

static inline uint64_t word_at(const uint8_t *p)
{
    uint64_t word;
    memcpy(&word, p, sizeof word);
    return word;
}

#define EACH(byte) ((uint64_t)(byte) * 0x0101010101010101ull)

/* As many first bytes of a word, 0 to 8. */
static inline uint64_t first_bytes(unsigned count)
{
    return count >= WORD ? ~0ull : (1ull << (8 * count)) - 1;
}

static inline int are_decimal(const uint8_t *p, Size count)
{
    uint64_t bad = 0;
    for (Size k = 0; k < count; k += WORD) {
        uint64_t digits = (word_at(p + k) ^ EACH('0')) & first_bytes((unsigned)(count - k));
        bad |= digits | (digits + EACH(0x76)); /* from 10 on it carries into the highest bit */
    }
    return !(bad & EACH(0x80));
}

static inline int are_hex(const uint8_t *p, Size count)
{
    uint64_t good = EACH(0x80), high = 0;
    for (Size k = 0; k < count; k += WORD) {
        uint64_t own = first_bytes((unsigned)(count - k));
        uint64_t word = (word_at(p + k) & own) | (EACH('0') & ~own);
        high |= word;
        uint64_t low7 = word & EACH(0x7F);
        uint64_t digit = (low7 ^ EACH('0')) + EACH(0x76);      /* highest bit: no digit */
        uint64_t letter = (low7 | EACH(0x20)) ^ EACH(0x60);    /* a to f become 1 to 6 */
        uint64_t is_letter = ~(letter + EACH(0x79)) & (letter + EACH(0x7F));
        good &= ~digit | is_letter;
    }
    return (good & EACH(0x80)) == EACH(0x80) && !(high & EACH(0x80));
}

static inline unsigned nibble(uint8_t c)
{
    return (c & 0x0Fu) + 9u * (c >> 6);
}

/* Bytes of hexadecimal digits that are known to be some; 16 digits are read. */
static inline uint64_t eight_bytes(const uint8_t *p, unsigned count)
{
    uint64_t out = 0;
    for (unsigned half = 0; half < 2; half++) {
        uint64_t v = word_at(p + 8 * half);
        v = (v & EACH(0x0F)) + 9 * ((v >> 6) & EACH(0x01));
        v = ((v << 4) | (v >> 8)) & 0x00FF00FF00FF00FFull;
        v = (v | (v >> 8)) & 0x0000FFFF0000FFFFull;
        v = (v | (v >> 16)) & 0xFFFFFFFFull;
        out |= v << (32 * half);
    }
    return out & first_bytes(count);
}

/* The number that eight values 0 to 9 in bytes spell: joined to pairs, fours, all. */
static inline uint64_t eight_digits(uint64_t v)
{
    v = 10 * v + (v >> 8);
    v = (v & 0x000000FF000000FFull) * (100 + (1000000ull << 32)) +
        ((v >> 16) & 0x000000FF000000FFull) * (1 + (10000ull << 32));
    return v >> 32;
}

/* The number that decimal digits spell, as many as 64 bits hold. */
static inline uint64_t decimal(const uint8_t *p, Size count)
{
    Size first = count % WORD;
    uint64_t number = 0;
    if (first)
        number = eight_digits((word_at(p) & EACH(0x0F)) << (8 * (WORD - first)));
    for (Size k = first; k < count; k += WORD)
        number = 100000000 * number + eight_digits(word_at(p + k) & EACH(0x0F));
    return number;
}

/* The number of a stamp at p; not a number where no double holds its digits. */
static inline double stamp_of(const uint8_t *p, Size seconds, Size fraction)
{
    if (seconds + fraction > MOST_DIGITS)
        return NAN;
    uint64_t whole = decimal(p, seconds) * (uint64_t)POWERS[fraction] +
                     decimal(p + seconds + 1, fraction);
    return whole < EXACT ? (double)whole / POWERS[fraction] : NAN;
}

/* The channels that are known, each with the filter of its ids (`IdFilter`). */
typedef struct {
    Size count;
    const uint8_t *names;     /* (C, 1 + NAME): length, name */
    const uint8_t *verdicts;  /* (C, VERDICTS): 1 wanted, 0 not, 2 no id */
    const uint8_t *everything; /* (C,) */
    const uint32_t *exact;    /* wanted ids of 29 bits, those of channel c from exact_of[c] on */
    const int64_t *exact_of;
    const uint32_t *masked;   /* (K, 2): id, mask */
    const int64_t *masked_of;
} Channels;

static int is_wanted(const Channels *known, Size channel, uint32_t id)
{
    if (known->everything[channel])
        return 1;
    for (int64_t k = known->exact_of[channel]; k < known->exact_of[channel + 1]; k++)
        if (known->exact[k] == id)
            return 1;
    for (int64_t k = known->masked_of[channel]; k < known->masked_of[channel + 1]; k++)
        if ((id & known->masked[2 * k + 1]) == known->masked[2 * k])
            return 1;
    return 0;
}

typedef struct {
    Size seconds, fraction; /* digits */
    Size channel;
    uint32_t id;
    int is_wanted, is_fd;
    const uint8_t *data;
    Size digits;
} Frame;

enum Judgement { ODD_LINE, TAKEN, UNKNOWN_CHANNEL };

/* Judge the line from p up to its newline at `end`. */
static enum Judgement judge(const uint8_t *p, const uint8_t *end, const Channels *known,
                            Frame *frame)
{
    if (end > p && end[-1] == '\r')
        end--;
    if (end - p >= 2 && (end[-1] == 'R' || end[-1] == 'T') && end[-2] == ' ')
        end -= 2;
    if (end - p < 12 || *p != '(')
        return ODD_LINE;
    const uint8_t *at = p + 1;
    Size n = 0, m = 0;
    while (at + n < end && n <= MOST_SECONDS && at[n] != '.')
        n++;
    while (at + n + 1 + m < end && m <= MOST_FRACTION && at[n + 1 + m] != ')')
        m++;
    if (n < 1 || n > MOST_SECONDS || m < 1 || m > MOST_FRACTION || at + n + 1 + m >= end)
        return ODD_LINE;
    frame->seconds = n;
    frame->fraction = m;
    if (!are_decimal(at, frame->seconds) || !are_decimal(at + frame->seconds + 1, frame->fraction))
        return ODD_LINE;
    at += frame->seconds + frame->fraction + 2;
    const uint8_t *gap = at;
    while (at < end && *at == ' ')
        at++;
    if (at == gap || at - gap > MOST_GAP)
        return ODD_LINE;
    Size channel = -1, length = 0;
    while (at + length < end && at[length] != ' ')
        length++;
    if (at + length >= end || length < 1 || length > NAME)
        return ODD_LINE;
    for (Size c = 0; c < known->count && channel < 0; c++) {
        const uint8_t *name = known->names + c * (1 + NAME);
        if (name[0] == length && !memcmp(at, name + 1, (size_t)length))
            channel = c;
    }
    if (channel < 0)
        return UNKNOWN_CHANNEL;
    frame->channel = channel;
    at += length + 1;
    Size left = end - at;
    if (left > STANDARD_DIGITS && at[STANDARD_DIGITS] == '#') {
        if (!are_hex(at, STANDARD_DIGITS))
            return ODD_LINE;
        frame->id = nibble(at[0]) << 8 | nibble(at[1]) << 4 | nibble(at[2]);
        uint8_t verdict = known->verdicts[channel * VERDICTS + frame->id];
        if (verdict > 1)
            return ODD_LINE;
        frame->is_wanted = verdict;
        at += STANDARD_DIGITS + 1;
    } else if (left > EXTENDED_DIGITS && at[EXTENDED_DIGITS] == '#') {
        if (!are_hex(at, EXTENDED_DIGITS))
            return ODD_LINE;
        uint32_t id = 0;
        for (int k = 0; k < EXTENDED_DIGITS; k++)
            id = id << 4 | nibble(at[k]);
        if (id > EFF_MASK)
            return ODD_LINE;
        frame->is_wanted = is_wanted(known, channel, id);
        frame->id = id | EFF_FLAG;
        at += EXTENDED_DIGITS + 1;
    } else {
        return ODD_LINE;
    }
    frame->is_fd = at < end && *at == '#';
    if (frame->is_fd) { /* a digit of flags goes before the data */
        if (end - at < 2 || !are_hex(at + 1, 1))
            return ODD_LINE;
        at += 2;
    }
    frame->data = at;
    frame->digits = end - at;
    if (frame->digits > 2 * (frame->is_fd ? LONGEST : CLASSIC) || frame->digits % 2)
        return ODD_LINE;
    return are_hex(at, frame->digits) ? TAKEN : ODD_LINE;
}

/* Read the lines of text[:size], which are whole, from counts[PLACE] on.

   Wanted frames go to the columns t .. place, as many as those are long; lines that are odd to
   `odd`, each with its number and its place. counts go on from what they hold. The time of a frame
   whose digits no double holds is NaN, for the caller to read. Stops early at a channel that is not
   known, where `odd` or the frames are full, and at a wanted frame that the columns of data are too
   narrow for. */
KERNEL long candump(PyObject *text_, long size, PyObject *names_, PyObject *verdicts_,
                    PyObject *everything_, PyObject *exact_, PyObject *exact_of_,
                    PyObject *masked_, PyObject *masked_of_, PyObject *t_, PyObject *id_,
                    PyObject *length_, PyObject *data_, PyObject *channel_, PyObject *fd_,
                    PyObject *place_, PyObject *odd_, PyObject *counts_)
{
    Arrays a = {0};
    Channels known;
    const uint8_t *text = take(&a, text_, 'B', SHAPE(ANY));
    Size room = length_of(&a, 0);
    known.names = take(&a, names_, 'B', SHAPE(ANY, 1 + NAME));
    known.count = length_of(&a, 0);
    known.verdicts = take(&a, verdicts_, 'B', SHAPE(known.count, VERDICTS));
    known.everything = take(&a, everything_, 'B', SHAPE(known.count));
    known.exact = take(&a, exact_, 'I', SHAPE(ANY));
    Size exact = length_of(&a, 0);
    known.exact_of = take(&a, exact_of_, 'q', SHAPE(known.count + 1));
    known.masked = take(&a, masked_, 'I', SHAPE(ANY, 2));
    Size masked = length_of(&a, 0);
    known.masked_of = take(&a, masked_of_, 'q', SHAPE(known.count + 1));
    double *t = doubles_out(&a, t_, SHAPE(ANY));
    Size most = length_of(&a, 0);
    uint32_t *id = take_out(&a, id_, 'I', SHAPE(most));
    uint8_t *length = take_out(&a, length_, 'B', SHAPE(most));
    uint8_t *data = take_out(&a, data_, 'B', SHAPE(most, ANY));
    Size width = length_of(&a, 1);
    uint8_t *channel = take_out(&a, channel_, 'B', SHAPE(most));
    uint8_t *fd = take_out(&a, fd_, '?', SHAPE(most));
    int64_t *place = take_out(&a, place_, 'q', SHAPE(most));
    int64_t *odd = take_out(&a, odd_, 'q', SHAPE(ANY, 2));
    Size most_odd = length_of(&a, 0);
    int64_t *counts = take_out(&a, counts_, 'q', SHAPE(COUNTS));
    if (a.failed)
        return leave(&a, -1);
    int fits = size >= 0 && size <= room - PADDING && (width == CLASSIC || width == LONGEST) &&
               counts[PLACE] >= 0 && counts[FRAMES] >= 0 && counts[ODD] >= 0 &&
               counts[ODD] <= most_odd && counts[FRAMES] <= most && counts[NUMBER] >= 0 &&
               counts[NUMBER] <= LARGEST_COUNT;
    for (Size c = 0; fits && c < known.count; c++)
        fits = known.names[c * (1 + NAME)] <= NAME && 0 <= known.exact_of[c] &&
               known.exact_of[c] <= known.exact_of[c + 1] && known.exact_of[c + 1] <= exact &&
               0 <= known.masked_of[c] && known.masked_of[c] <= known.masked_of[c + 1] &&
               known.masked_of[c + 1] <= masked;
    if (!fits)
        return leave(&a, refuse(&a, "numbers beyond the arrays of candump"));
    enum Result result = DONE;
    Frame frame = {0};
    Size n = (Size)counts[FRAMES], at = (Size)counts[PLACE];
    int64_t number = counts[NUMBER];
    while (at < size) {
        const uint8_t *newline = memchr(text + at, '\n', (size_t)(size - at));
        if (!newline)
            break;
        enum Judgement judged = judge(text + at, newline, &known, &frame);
        if (judged == UNKNOWN_CHANNEL) {
            result = NEW_CHANNEL;
            break;
        }
        if (judged == ODD_LINE) {
            if (counts[ODD] == most_odd) {
                result = ODD_IS_FULL;
                break;
            }
            odd[2 * counts[ODD]] = number;
            odd[2 * counts[ODD] + 1] = at;
            counts[ODD]++;
        } else {
            if (frame.is_wanted) {
                Size bytes = frame.digits / 2;
                if (n == most || bytes > width) {
                    result = n == most ? FRAMES_FULL : LONG_FRAME;
                    break;
                }
                double stamp = stamp_of(text + at + 1, frame.seconds, frame.fraction);
                t[n] = stamp;
                counts[AS_TEXT] += stamp != stamp;
                id[n] = frame.id;
                length[n] = (uint8_t)bytes;
                channel[n] = (uint8_t)frame.channel;
                fd[n] = (uint8_t)frame.is_fd;
                counts[ANY_FD] |= frame.is_fd;
                place[n] = at;
                for (Size k = 0; k < width; k += WORD) {
                    uint64_t part = 0;
                    if (k < bytes)
                        part = eight_bytes(frame.data + 2 * k, (unsigned)(bytes - k));
                    memcpy(data + n * width + k, &part, WORD);
                }
                n++;
            }
        }
        number++;
        at = newline + 1 - text;
    }
    counts[PLACE] = at;
    counts[NUMBER] = number;
    counts[FRAMES] = n;
    return leave(&a, result);
}
