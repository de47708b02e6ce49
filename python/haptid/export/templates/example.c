/*
 * A haptic callback at a fixed rate with gravity and friction compensation and the observer of the hand's torque.
 * Replace read_encoders and write_torques by those of your device.
 */
#include "@{name}.h"

#include <stdio.h>

#define N @{NAME}_COORDINATES
#define DT @{step}
#define TICKS 1000

typedef struct {
    @{name}_model model;
    @{name}_observer observer;
    @{name}_differentiator differentiator;@{loops_field}
    @{name}_real tau[N]; /* motor torque of the last tick */
    int wrong;           /* stop the motors unless it is zero */
} haptic_state;

static void read_encoders(int tick, @{name}_real q[N])
{
    int i;
    for (i = 0; i < N; i++) {
        q[i] = @{start}(@{name}_real)tick * @{creep};
    }
}

static void write_torques(const @{name}_real tau[N])
{
    (void)tau;
}

static void haptic_callback(haptic_state *state, int tick, @{name}_real hand[N])
{
    @{name}_real q[N];
    @{name}_real qd[N];
    @{name}_real friction[N];
    int i;
    read_encoders(tick, q);@{loops_closed}
    @{name}_differentiator_update(&state->differentiator, q, qd);
    @{name}_observer_update(&state->model, &state->observer, q, @{z}qd, state->tau, hand);
    @{name}_gravity(&state->model, q, @{z}state->tau);
    @{name}_friction_compensation(&state->model, @{qz}qd, @{half}, friction);
    for (i = 0; i < N; i++) {
        state->tau[i] += friction[i]; /* add the force of the virtual scene here, and limit the sum */
    }
    write_torques(state->tau);
}

int main(void)
{
    static haptic_state state;
    @{name}_real hand[N];
    int tick;
    int i;
    @{name}_init(&state.model, @{name}_beta);
    state.wrong = @{name}_observer_init(&state.observer, @{gain}, DT);
    state.wrong += @{name}_differentiator_init(&state.differentiator, @{cutoff}, DT);@{loops_start}
    for (tick = 0; (tick < TICKS) && (state.wrong == 0); tick++) {
        haptic_callback(&state, tick, hand);
    }
    for (i = 0; (i < N) && (state.wrong == 0); i++) {
        (void)printf("torque of the hand on coordinate %d: %g\n", i + 1, (double)hand[i]);
    }
    return state.wrong;
}
