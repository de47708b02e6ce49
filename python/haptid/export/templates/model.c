/* @{title}: see @{name}.h. */
/* Straight-line code; @{counts}. */
#include "@{name}.h"

#include <math.h>

const double @{name}_beta[@{NAME}_PARAMETERS] = {
@{beta}
};

void @{name}_init(@{name}_model *model, const double p[@{NAME}_PARAMETERS])
{
@{init}
}
@{bodies}
void @{name}_torque(const @{name}_model *model, const @{name}_real q[@{n}], @{z_declared}const @{name}_real qd[@{n}],
                    const @{name}_real qdd[@{n}], @{name}_real tau[@{n}])
{
    @{real} terms[@{n}];
    int i;
    @{name}_inverse_dynamics(model, q, @{z}qd, qdd, tau);
    @{name}_terms(model, q, @{z}qd, terms);
    for (i = 0; i < @{n}; i++) {
        tau[i] += terms[i];
    }
}

void @{name}_friction_compensation(const @{name}_model *model, @{qz_declared}const @{name}_real qd[@{n}], @{name}_real share,
                                   @{name}_real tau[@{n}])
{
    const @{real} limited = fmin@{f}(fmax@{f}(share, @{zero}), @{one});
    int i;
    @{name}_friction(model, @{qz}qd, tau);
    for (i = 0; i < @{n}; i++) {
        tau[i] *= limited;
    }
}

int @{name}_observer_init(@{name}_observer *observer, @{name}_real gain, @{name}_real dt)
{
    const int sound = (gain > @{zero}) && (dt > @{zero});
    int i;
    observer->dt = (sound != 0) ? dt : @{one};
    observer->keep = (sound != 0) ? exp@{f}(-(gain * dt)) : @{zero};
    observer->started = 0;
    for (i = 0; i < @{n}; i++) {
        observer->p[i] = @{zero};
        observer->pushed[i] = @{zero};
        observer->torque[i] = @{zero};
    }
    return (sound != 0) ? 0 : 1;
}

void @{name}_observer_update(const @{name}_model *model, @{name}_observer *observer, const @{name}_real q[@{n}],
                             @{z_declared}const @{name}_real qd[@{n}], const @{name}_real tau[@{n}], @{name}_real torque[@{n}])
{
    @{real} p[@{n}];
    @{real} rest[@{n}];
    @{real} terms[@{n}];
    int i;
    @{name}_momentum(model, q, @{z}qd, p, rest);
    @{name}_terms(model, q, @{z}qd, terms);
    for (i = 0; i < @{n}; i++) {
        const @{real} pushed = tau[i] - rest[i] - terms[i];
        if (observer->started != 0) {
            /* Over a step the momentum changes by the mean torque: the unexplained part is that of the hand. */
            const @{real} explained = @{half} * (pushed + observer->pushed[i]);
            const @{real} mean = ((p[i] - observer->p[i]) / observer->dt) - explained;
            observer->torque[i] = (observer->keep * observer->torque[i]) + ((@{one} - observer->keep) * mean);
        }
        observer->p[i] = p[i];
        observer->pushed[i] = pushed;
        torque[i] = observer->torque[i];
    }
    observer->started = 1;
}

int @{name}_differentiator_init(@{name}_differentiator *filter, @{name}_real cutoff_hz, @{name}_real dt)
{
    const int sound = (cutoff_hz > @{zero}) && (dt > @{zero}) && ((cutoff_hz * dt) < @{half});
    const @{real} x = @{tau} * cutoff_hz * dt;
    int i;
    filter->b = (sound != 0) ? (((@{two} * x) / (@{two} + x)) / dt) : @{zero};
    filter->a = (sound != 0) ? ((@{two} - x) / (@{two} + x)) : @{zero};
    filter->started = 0;
    for (i = 0; i < @{n}; i++) {
        filter->q[i] = @{zero};
        filter->qd[i] = @{zero};
    }
    return (sound != 0) ? 0 : 1;
}

void @{name}_differentiator_update(@{name}_differentiator *filter, const @{name}_real q[@{n}], @{name}_real qd[@{n}])
{
    int i;
    for (i = 0; i < @{n}; i++) {
        if (filter->started != 0) {
            filter->qd[i] = (filter->b * (q[i] - filter->q[i])) + (filter->a * filter->qd[i]);
        }
        filter->q[i] = q[i];
        qd[i] = filter->qd[i];
    }
    filter->started = 1;
}
@{handle}@{loops}@{elastic}
