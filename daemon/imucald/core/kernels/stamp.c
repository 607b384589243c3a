/* From which sources the library was built, so that one of other sources is not used. */

#include "arrays.h"

KERNEL unsigned long stamp(void);

unsigned long stamp(void)
{
    return STAMP;
}
