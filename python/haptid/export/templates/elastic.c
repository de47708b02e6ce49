

static const int @{name}_torsions[@{springs}] = {@{torsions}};

int @{name}_elastic_init(@{name}_elastic *state, @{name}_real gain, @{name}_real dt)
{
    const int sound = (gain > @{zero}) && (dt > @{zero});
    int i;
    state->dt = (sound != 0) ? dt : @{one};
    state->keep = (sound != 0) ? exp@{f}(-(gain * dt)) : @{zero};
    state->started = 0;
    for (i = 0; i < @{springs}; i++) {
        state->p[i] = @{zero};
        state->pushed[i] = @{zero};
        state->spring[i] = @{zero};
        state->torsion[i] = @{zero};
        state->rate[i] = @{zero};
        state->acceleration[i] = @{zero};
    }
    return (sound != 0) ? 0 : 1;
}

/* K x + D x' = spring from sample to sample, exactly where the spring's torque is linear in time between them. */
static void @{name}_bend(const @{name}_model *model, @{name}_elastic *state, const @{name}_real spring[@{springs}])
{
    @{real} stiffness[@{springs}];
    @{real} damping[@{springs}];
    int i;
    @{name}_springs(model, stiffness, damping);
    for (i = 0; i < @{springs}; i++) {
        const @{real} lag = damping[i] / stiffness[i];
        const @{real} keep = (lag > @{zero}) ? exp@{f}(-(state->dt / lag)) : @{zero};
        const @{real} change = (state->started != 0) ? ((spring[i] - state->spring[i]) / (stiffness[i] * state->dt)) : @{zero};
        const @{real} rate = (keep * state->rate[i]) + ((@{one} - keep) * change);
        state->acceleration[i] = (state->started != 0) ? ((rate - state->rate[i]) / state->dt) : @{zero};
        state->rate[i] = rate;
        state->torsion[i] = (spring[i] / stiffness[i]) - (lag * rate);
        state->spring[i] = spring[i];
    }
    state->started = 1;
}

void @{name}_elastic_plan(const @{name}_model *model, @{name}_elastic *state, @{name}_real q[@{n}],
                          @{z_declared}@{name}_real qd[@{n}], @{name}_real qdd[@{n}], @{name}_real tau[@{n}])
{
    @{real} spring[@{springs}];
    int i;
    @{name}_spring_torque(model, q, @{z}qd, qdd, spring);
    @{name}_bend(model, state, spring);
    for (i = 0; i < @{springs}; i++) {
        q[@{name}_torsions[i]] = state->torsion[i];
        qd[@{name}_torsions[i]] = state->rate[i];
        qdd[@{name}_torsions[i]] = state->acceleration[i];
    }
    @{name}_torque(model, q, @{z}qd, qdd, tau);
}

void @{name}_elastic_estimate(const @{name}_model *model, @{name}_elastic *state, const @{name}_real theta[@{springs}],
                              const @{name}_real thetad[@{springs}], const @{name}_real motor[@{springs}], @{name}_real torsion[@{springs}],
                              @{name}_real spring[@{springs}])
{
    @{real} p[@{springs}];
    @{real} rest[@{springs}];
    int i;
    @{name}_rotors(model, theta, thetad, p, rest);
    for (i = 0; i < @{springs}; i++) {
        const @{real} pushed = motor[i] - rest[i];
        spring[i] = pushed;
        if (state->started != 0) {
            /* Over a step the rotor's momentum changes by the mean torque: what is not explained is in the spring. */
            const @{real} mean = (@{half} * (pushed + state->pushed[i])) - ((p[i] - state->p[i]) / state->dt);
            spring[i] = (state->keep * state->spring[i]) + ((@{one} - state->keep) * mean);
        }
        state->p[i] = p[i];
        state->pushed[i] = pushed;
    }
    @{name}_bend(model, state, spring);
    for (i = 0; i < @{springs}; i++) {
        torsion[i] = state->torsion[i];
    }
}
