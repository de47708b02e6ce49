// Plays a campaign of `haptid excite --player swing.c` on a delta of Force Dimension (omega, delta, sigma) and records it.
//
//   c++ -O2 -o campaign force_dimension.cpp -ldhd && ./campaign 0.2 > swing-1.csv
//
// The three actuated joints of the delta, in rad and N m. The gains are yours: begin with small ones.
#include <dhdc.h>

#include <cstdio>
#include <cstdlib>
#define SWING_STDIO
#include "swing.c"

static_assert(SWING_JOINTS == 3, "the delta has three actuated joints");
static const double KP = 5.0, KD = 0.1;  // N m/rad, N m s/rad

int main(int count, char **words)
{
    const double speed = count > 1 ? std::atof(words[1]) : 0.2;
    static swing_state s;
    static swing_row rows[256];
    double q[3], q_ref[3], qd_ref[3], tau[3] = {}, share = 1.0;
    if (dhdOpen() < 0 || dhdGetDeltaJointAngles(&q[0], &q[1], &q[2]) < 0) {
        std::fprintf(stderr, "no device: %s\n", dhdErrorGetLastStr());
        return 2;
    }
    dhdEnableForce(DHD_ON);
    swing_start(&s, 0, speed, q);
    double before = dhdGetTime();
    for (int status = s.status, head = 1; status != SWING_DONE && (status != SWING_STOPPED || share > 0.0); head = 0) {
        const double now = dhdGetTime();
        if (dhdGetDeltaJointAngles(&q[0], &q[1], &q[2]) < 0) { swing_stop(&s); }
        status = swing_step(&s, now - before, q, tau, q_ref, qd_ref, &share);
        for (int j = 0; j < 3; ++j) { tau[j] = share * (KP * (q_ref[j] - q[j]) + KD * (qd_ref[j] - s.rate[j])); }
        dhdSetDeltaJointTorques(tau[0], tau[1], tau[2]);
        before = now;
        // On a system without real-time threads, print after the loop: the buffer holds SWING_RECORDS rows.
        swing_print(stdout, rows, swing_read(&s, rows, 256), head);
    }
    dhdClose();
    if (s.status != SWING_DONE) { std::fprintf(stderr, "stopped: reason %d, joint %d\n", s.reason, s.joint); }
    return s.status == SWING_DONE ? 0 : 1;
}
