/* The device behind the stub headers: three joints of an inertia and a viscous friction each, at 1 kHz. */
#ifndef PLANT_H
#define PLANT_H
static double plant_q[3], plant_v[3], plant_t;
static void plant_torque(const double *tau) {
  int j;
  for (j = 0; j < 3; ++j) {
    plant_v[j] += 1e-3 * (tau[j] - 0.002 * plant_v[j]) / 0.002;
    plant_q[j] += 1e-3 * plant_v[j];
  }
  plant_t += 1e-3;
}
#endif
