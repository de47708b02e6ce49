/*
@{about}
 *
 * All values are SI. Vectors q, qd, qdd and tau have one entry for each coordinate:
@{coordinates}
 * Matrices are row-major. The base frame is that of the device file.
 *
 * No function allocates memory or has shared state: calls from several threads are safe as long as each thread has its
 * own observer and differentiator. Where a function returns int, 0 is success; otherwise its outputs are zeros.
 *
@{worst_case}
@{precision} */
#ifndef @{NAME}_H
#define @{NAME}_H

#ifdef __cplusplus
extern "C" {
#endif

#define @{NAME}_COORDINATES @{n}
#define @{NAME}_PARAMETERS @{p}@{passive_count}

typedef @{real} @{name}_real;

/* Values precomputed from the base parameters by @{name}_init. */
typedef struct {
    @{name}_real k[@{k}];
} @{name}_model;

/* The base parameters as identified:
@{parameters}
 */
extern const double @{name}_beta[@{NAME}_PARAMETERS];

/* Initialise a model with base parameters: @{name}_beta, or others. */
void @{name}_init(@{name}_model *model, const double p[@{NAME}_PARAMETERS]);

@{prototypes}
/* Inverse dynamics including all terms: motor torque for this motion, N m or N. */
void @{name}_torque(const @{name}_model *model, const @{name}_real q[@{n}], @{z_declared}const @{name}_real qd[@{n}],
                    const @{name}_real qdd[@{n}], @{name}_real tau[@{n}]);

/*
 * Friction compensation: a share of the friction torque, to be added to the motor torque, N m or N. Below @{speed} rad/s
 * (or m/s) it passes smoothly through zero, so that velocity noise does not cause chatter. The share is limited to
 * 0 .. 1: overcompensation makes the device unstable. Begin with 0.5.
 */
void @{name}_friction_compensation(const @{name}_model *model, @{qz_declared}const @{name}_real qd[@{n}], @{name}_real share,
                                   @{name}_real tau[@{n}]);

/*
 * Momentum observer (De Luca and Mattone 2005): torque of the hand through the low-pass gain / (s + gain), without
 * accelerations. Call it at every sample, with the motor torque at that sample.
 */
typedef struct {
    @{name}_real dt;
    @{name}_real keep;
    int started;
    @{name}_real p[@{n}];
    @{name}_real pushed[@{n}];
    @{name}_real torque[@{n}];
} @{name}_observer;

/* gain in rad/s (40 is a good start), dt in s; returns 1 unless both are positive. */
int @{name}_observer_init(@{name}_observer *observer, @{name}_real gain, @{name}_real dt);

/* Next sample: torque of the hand on every coordinate, N m or N. */
void @{name}_observer_update(const @{name}_model *model, @{name}_observer *observer, const @{name}_real q[@{n}],
                             @{z_declared}const @{name}_real qd[@{n}], const @{name}_real tau[@{n}], @{name}_real torque[@{n}]);

/* Velocity of sampled positions: s w / (s + w), discretised by Tustin's rule; delay 1 / w. */
typedef struct {
    @{name}_real a;
    @{name}_real b;
    int started;
    @{name}_real q[@{n}];
    @{name}_real qd[@{n}];
} @{name}_differentiator;

/* cutoff_hz = w / (2 pi) below half the sampling rate, dt in s; returns 1 otherwise. */
int @{name}_differentiator_init(@{name}_differentiator *filter, @{name}_real cutoff_hz, @{name}_real dt);

/* Next sample; at rest before the first one. */
void @{name}_differentiator_update(@{name}_differentiator *filter, const @{name}_real q[@{n}], @{name}_real qd[@{n}]);
@{loops}@{elastic}@{handle}
#ifdef __cplusplus
}
#endif

#endif
