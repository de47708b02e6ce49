/*
@{about}
 *
 * Numbers are SI. Vectors q, qd, qdd and tau have one entry for each coordinate:
@{coordinates}
 * Matrices are stored row by row. The base frame is that of the device file.
 *
 * Nothing here allocates memory, and nothing is shared: calls from several threads are safe as long as each thread has
 * its own observer and differentiator. Where a function returns int, 0 is success; otherwise its outputs are zeros.
 */
#ifndef @{NAME}_H
#define @{NAME}_H

#ifdef __cplusplus
extern "C" {
#endif

#define @{NAME}_COORDINATES @{n}
#define @{NAME}_PARAMETERS @{p}

typedef @{real} @{name}_real;

/* All that depends on the base parameters alone. Fill it with @{name}_init, once. */
typedef struct {
    @{name}_real k[@{k}];
} @{name}_model;

/* The base parameters as identified:
@{parameters}
 */
extern const double @{name}_beta[@{NAME}_PARAMETERS];

/* Make a model of base parameters: @{name}_beta, or others. */
void @{name}_init(@{name}_model *model, const double p[@{NAME}_PARAMETERS]);

@{prototypes}
/* Torque of bodies, rotors and all terms: what the motors must give for this motion, N m or N. */
void @{name}_torque(const @{name}_model *model, const @{name}_real q[@{n}], const @{name}_real qd[@{n}],
                    const @{name}_real qdd[@{n}], @{name}_real tau[@{n}]);

/*
 * A share of the friction, to be added to the motors' torque, N m or N. Below @{speed} rad/s (or m/s) it goes smoothly
 * through zero, so that noise of the velocity does not make the motors chatter. A share is 0 to 1 and is cut to that:
 * what is compensated beyond the true friction drives the device by itself. Begin with 0.5.
 */
void @{name}_friction_compensation(const @{name}_model *model, const @{name}_real qd[@{n}], @{name}_real share,
                                   @{name}_real tau[@{n}]);

/*
 * The hand's torque by the momentum observer (De Luca and Mattone 2005): the low-pass gain / (s + gain) of it. It needs
 * no accelerations. Give it every sample, with the motors' torque at that sample.
 */
typedef struct {
    @{name}_real dt;
    @{name}_real keep;
    int started;
    @{name}_real p[@{n}];
    @{name}_real pushed[@{n}];
    @{name}_real torque[@{n}];
} @{name}_observer;

/* gain in rad/s (40 is a good start), dt in s; returns 1 unless both are above zero. */
int @{name}_observer_init(@{name}_observer *observer, @{name}_real gain, @{name}_real dt);

/* One more sample: torque of the hand on every coordinate, N m or N. */
void @{name}_observer_update(const @{name}_model *model, @{name}_observer *observer, const @{name}_real q[@{n}],
                             const @{name}_real qd[@{n}], const @{name}_real tau[@{n}], @{name}_real torque[@{n}]);

/* Velocity of sampled positions by s w / (s + w), Tustin's rule: it lags by 1 / w. */
typedef struct {
    @{name}_real a;
    @{name}_real b;
    int started;
    @{name}_real q[@{n}];
    @{name}_real qd[@{n}];
} @{name}_differentiator;

/* cutoff_hz = w / (2 pi) below half the sampling rate, dt in s; returns 1 otherwise. */
int @{name}_differentiator_init(@{name}_differentiator *filter, @{name}_real cutoff_hz, @{name}_real dt);

/* One more sample; at rest before the first one. */
void @{name}_differentiator_update(@{name}_differentiator *filter, const @{name}_real q[@{n}], @{name}_real qd[@{n}]);
@{handle}
#ifdef __cplusplus
}
#endif

#endif
