/* What contact pairs see of a structure, along a parameter p: g_lin(p) - R(p) b of forces b. */
#ifndef COMPLIANCE_H
#define COMPLIANCE_H

/*     R_k(p)   = R_k,  or  P^T h_k P + at_once   with h_kj = 1 / (s_j - (k w)^2 + i k w d c_j),
 *     g_lin(p) = linear + p linear_rate  +  P^T h_k l_k,
 *     w(p)     = omega + p omega_rate,           d(p) = damping + p damping_rate.
 *
 * Coefficients stand as in switching.h, n = (2H+1) pairs of them; complex numbers one part after
 * the other. All arrays are the caller's, and stay.
 */
typedef struct {
    int harmonics, pairs, modes;        /* 0 modes where R is given */
    const double *linear, *linear_rate; /* (2H+1, pairs) */
    const double *compliance;           /* R: (H+1, pairs, pairs), complex */
    double omega, omega_rate, damping, damping_rate;
    const double *squares, *modal_damping; /* s, c: (modes) */
    const double *shapes;               /* P: (modes, pairs) */
    const double *load;                 /* l: (H+1, modes), complex */
    const double *static_compliance;    /* (pairs, pairs), or NULL */
} structure_at_pairs;

/* Of s + (k w)^2: below what an undamped resonance has no answer; without load it is moved away by the
 * root of rounding (fenics_crack/model/modal.py, AllModes.receptance). */
extern const double SINGULARITY_TOLERANCE;

typedef struct compliance compliance;

/* NULL without memory. */
compliance *new_compliance(const structure_at_pairs *given);
void free_compliance(compliance *self);
/* Goes to a parameter: 0, or 1 where the structure is singular. */
int set_parameter(compliance *self, double parameter);
/* R there, (H+1, pairs, pairs) complex. */
const double *get_compliance_matrices(compliance *self);
/* R b - g_lin of forces b (2H+1, pairs), and behind it its derivative by the parameter for this b. */
void evaluate_response(compliance *self, const double *force, double *gap_out);
void differentiate_response(compliance *self, double *gap_out);
/* R b alone. */
void respond_at_parameter(compliance *self, const double *force, double *gap);
/* Largest sum of |R_k| over a row of it at a parameter; infinite where the structure is singular. */
double largest_row_sum(compliance *self, double parameter);

/* R b of coefficients b (2H+1, pairs), from R (H+1, pairs, pairs), complex. */
void respond(int harmonics, int pairs, const double *matrices, const double *force, double *gap);

#endif
