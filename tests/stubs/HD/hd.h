/* What the adapter uses of OpenHaptics; the scheduler runs the callback to its end at once. */
#ifndef STUB_HD_H
#define STUB_HD_H
#include "plant.h"
#define HDCALLBACK
#define HD_DEFAULT_DEVICE 0
#define HD_DEVICE_ERROR(X) ((X).errorCode != 0)
typedef unsigned HHD;
typedef unsigned HDSchedulerHandle;
typedef unsigned HDenum;
typedef unsigned HDCallbackCode;
typedef unsigned short HDushort;
typedef int HDint;
typedef double HDdouble;
typedef struct { int errorCode; } HDErrorInfo;
typedef HDCallbackCode(HDCALLBACK *HDSchedulerCallback)(void *);
enum { HD_CALLBACK_DONE, HD_CALLBACK_CONTINUE, HD_FORCE_OUTPUT, HD_DEFAULT_SCHEDULER_PRIORITY };
enum { HD_INSTANTANEOUS_UPDATE_RATE = 10, HD_CURRENT_JOINT_ANGLES, HD_CURRENT_JOINT_TORQUE };
static HHD hdInitDevice(int name) { return (HHD)name; }
static HHD hdGetCurrentDevice(void) { return 0u; }
static HDErrorInfo hdGetError(void) { HDErrorInfo none = {0}; return none; }
static void hdEnable(HDenum what) { (void)what; }
static void hdStartScheduler(void) {}
static void hdStopScheduler(void) {}
static void hdDisableDevice(HHD device) { (void)device; }
static void hdBeginFrame(HHD device) { (void)device; }
static void hdEndFrame(HHD device) { (void)device; }
static void hdGetIntegerv(HDenum what, HDint *to) { *to = what == HD_INSTANTANEOUS_UPDATE_RATE ? 1000 : 0; }
static void hdGetDoublev(HDenum what, HDdouble *to) {
  int j;
  for (j = 0; j < 3; ++j) to[j] = what == HD_CURRENT_JOINT_ANGLES ? plant_q[j] : 0.0;
}
static void hdSetDoublev(HDenum what, const HDdouble *from) {
  double tau[3];
  int j;
  for (j = 0; j < 3; ++j) tau[j] = what == HD_CURRENT_JOINT_TORQUE ? 1e-3 * from[j] : 0.0; /* mN m */
  plant_torque(tau);
}
static HDSchedulerHandle hdScheduleAsynchronous(HDSchedulerCallback run, void *data, HDushort priority) {
  while (run(data) == HD_CALLBACK_CONTINUE) {}
  return priority;
}
#endif
