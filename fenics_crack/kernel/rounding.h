/* What is taken for rounding. */
#ifndef ROUNDING_H
#define ROUNDING_H

/* Of the largest gap: excursions below are none. */
#define ROUNDING 1e-14
/* Error of gaps with which an answer is computed anew; a diagonal so small relative to that of the
 * compliance is 0. */
#define ACCURATE 1e-12

#endif
