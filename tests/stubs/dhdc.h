/* What the adapter uses of Force Dimension's SDK. */
#pragma once
#include "plant.h"
#define DHD_ON 1
static int dhdOpen() { return 0; }
static int dhdClose() { return 0; }
static int dhdEnableForce(unsigned char on, char = -1) { return on ? 0 : -1; }
static const char *dhdErrorGetLastStr() { return "none"; }
static double dhdGetTime() { return plant_t; }
static int dhdGetDeltaJointAngles(double *a, double *b, double *c, char = -1) {
  *a = plant_q[0], *b = plant_q[1], *c = plant_q[2];
  return 0;
}
static int dhdSetDeltaJointTorques(double a, double b, double c, char = -1) {
  const double tau[3] = {a, b, c};
  plant_torque(tau);
  return 0;
}
