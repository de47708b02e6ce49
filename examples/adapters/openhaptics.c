/* Plays a campaign of `haptid excite --player swing.c` on a device of OpenHaptics (Touch, PHANToM) and records it.

   cc -O2 -o campaign openhaptics.c -lHD -lm && ./campaign 0.2 > swing-1.csv

   Joint angles in rad; HD takes joint torques in mN m. The gains are yours: begin with small ones. */
#include <HD/hd.h>
#include <stdio.h>
#include <stdlib.h>
#define SWING_STDIO
#include "swing.c"

static const double KP[SWING_JOINTS] = {1.0, 1.0, 1.0}, KD[SWING_JOINTS] = {0.05, 0.05, 0.05}; /* N m/rad, N m s/rad */
static swing_state s;
static double tau[SWING_JOINTS];
static volatile int ended;

static HDCallbackCode HDCALLBACK period(void *data) {
  double q[SWING_JOINTS], q_ref[SWING_JOINTS], qd_ref[SWING_JOINTS], sent[SWING_JOINTS], share;
  const double *speed = data;
  HDint rate;
  int j, status;
  hdBeginFrame(hdGetCurrentDevice());
  hdGetIntegerv(HD_INSTANTANEOUS_UPDATE_RATE, &rate);
  hdGetDoublev(HD_CURRENT_JOINT_ANGLES, q);
  if (s.status == SWING_IDLE) swing_start(&s, 0, *speed, q);
  status = swing_step(&s, 1.0 / rate, q, tau, q_ref, qd_ref, &share);
  for (j = 0; j < SWING_JOINTS; ++j) {
    tau[j] = share * (KP[j] * (q_ref[j] - q[j]) + KD[j] * (qd_ref[j] - s.rate[j]));
    sent[j] = 1e3 * tau[j];
  }
  hdSetDoublev(HD_CURRENT_JOINT_TORQUE, sent);
  hdEndFrame(hdGetCurrentDevice());
  ended = status == SWING_DONE || (status == SWING_STOPPED && share <= 0.0) || HD_DEVICE_ERROR(hdGetError());
  return ended ? HD_CALLBACK_DONE : HD_CALLBACK_CONTINUE;
}

int main(int count, char **words) {
  double speed = count > 1 ? atof(words[1]) : 0.2;
  static swing_row rows[256];
  unsigned many;
  int head = 1, last;
  HHD device = hdInitDevice(HD_DEFAULT_DEVICE);
  if (HD_DEVICE_ERROR(hdGetError())) return fprintf(stderr, "no device\n"), 2;
  hdEnable(HD_FORCE_OUTPUT);
  hdStartScheduler();
  hdScheduleAsynchronous(period, &speed, HD_DEFAULT_SCHEDULER_PRIORITY);
  do {
    last = ended; /* before the rows are read, so that none is left */
    while ((many = swing_read(&s, rows, 256)) > 0) {
      swing_print(stdout, rows, many, head);
      head = 0;
    }
  } while (!last);
  hdStopScheduler();
  hdDisableDevice(device);
  if (s.status != SWING_DONE) fprintf(stderr, "stopped: reason %d, joint %d\n", s.reason, s.joint);
  return s.status == SWING_DONE ? 0 : 1;
}
