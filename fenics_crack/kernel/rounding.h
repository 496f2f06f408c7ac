/* What is taken for rounding. */
#ifndef ROUNDING_H
#define ROUNDING_H

#define ROUNDING 1e-14 /* of the largest gap: excursions below are none */
#define ACCURATE 1e-12 /* error of gaps with which an answer is computed anew */

#endif
