/* Plays exciting motions in a control loop; C99, no memory allocation, no library but math.h.

   static player_state s;                        one for each device
   player_start(&s, 0, 0.2, q);                  motion 0 at a fifth of its speed, from where the joints are
   in every period of the loop:
     status = player_step(&s, dt, q, tau, q_ref, qd_ref, &share);
     torque = share * (kp (q_ref - q) + kd (qd_ref - qd) + feedforward)
   player_read(&s, rows, many)                   recorded rows, oldest first, from this or another thread

   dt is the time since the last call by the loop's own clock, s; tau is recorded as it is given. share rises from 0
   at the start and falls to 0 after a fault: multiply the torque by it, so that nothing jumps. The joints first go to
   the first pose of the motion, then follow it, then stay at its end. A joint that leaves the range of the motions,
   or is too fast or too far from its reference, a period that is too long, or a number that is not finite stops it;
   s.reason says which, s.joint which joint. Times in rows begin with player_start; the row's number counts every
   step, so that rows that did not fit the ring buffer show as a gap. With PLAYER_STDIO, player_print writes CSV. */
#include <math.h>
#ifdef PLAYER_STDIO
#include <stdio.h>
#endif

/* DATA */

enum { PLAYER_IDLE, PLAYER_APPROACHING, PLAYER_PLAYING, PLAYER_DONE, PLAYER_STOPPED };
enum {
  PLAYER_NO_FAULT,
  PLAYER_TRACKING_ERROR,
  PLAYER_OUT_OF_RANGE,
  PLAYER_TOO_FAST,
  PLAYER_TOO_LATE,
  PLAYER_NOT_FINITE,
  PLAYER_ASKED,
  PLAYER_NO_SUCH_MOTION
};

typedef struct {
  unsigned number;
  int status;
  int motion;
  double t;
  double plan; /* time of the motion at its planned speed, s; negative before it */
  double q[PLAYER_JOINTS];
  double q_ref[PLAYER_JOINTS];
  double tau[PLAYER_JOINTS];
} player_row;

typedef struct {
  int status;
  int reason;
  int joint;
  int motion;
  double speed;
  double t;
  double plan;
  double way; /* duration of the way to the first pose, s */
  double share;
  double from[PLAYER_JOINTS];
  double last[PLAYER_JOINTS];
  double rate[PLAYER_JOINTS]; /* filtered velocity, for the watchdog */
  unsigned steps;
  unsigned lost;
  volatile unsigned written;
  volatile unsigned taken;
  player_row rows[PLAYER_RECORDS];
} player_state;

static void player_fault(player_state *s, int reason, int joint) {
  if (s->status != PLAYER_STOPPED) {
    s->status = PLAYER_STOPPED;
    s->reason = reason;
    s->joint = joint;
  }
}

/* Stop: share falls to 0. */
void player_stop(player_state *s) { player_fault(s, PLAYER_ASKED, -1); }

/* Begin a motion at a share of its speed, above 0 and up to 1, from positions q. Returns the status. */
int player_start(player_state *s, int motion, double speed, const double q[PLAYER_JOINTS]) {
  int j;
  s->status = PLAYER_APPROACHING;
  s->reason = PLAYER_NO_FAULT;
  s->joint = -1;
  s->motion = motion;
  s->speed = speed;
  s->t = 0.0;
  s->share = 0.0;
  s->way = PLAYER_FADE;
  s->steps = s->lost = 0u;
  s->written = s->taken = 0u;
  if (motion < 0 || motion >= PLAYER_MOTIONS || !(speed > 0.0) || speed > 1.0) {
    s->motion = 0;
    player_fault(s, PLAYER_NO_SUCH_MOTION, -1);
    return s->status;
  }
  for (j = 0; j < PLAYER_JOINTS; ++j) {
    const double apart = fabs(player_q[player_begin[motion]][j] - q[j]);
    if (!isfinite(q[j])) player_fault(s, PLAYER_NOT_FINITE, j);
    s->from[j] = s->last[j] = q[j];
    s->rate[j] = 0.0;
    /* 15/8: largest speed of a quintic over its mean. */
    if (player_approach[j] > 0.0) s->way = fmax(s->way, 1.875 * apart / (speed * player_approach[j]));
  }
  s->plan = -s->way;
  return s->status;
}

/* References: a quintic to the first pose, then cubic Hermite polynomials between the samples. */
static void player_reference(const player_state *s, double q_ref[PLAYER_JOINTS], double qd_ref[PLAYER_JOINTS]) {
  const unsigned first = player_begin[s->motion], last = player_begin[s->motion + 1] - 1u;
  int j;
  if (s->plan < 0.0) {
    const double x = 1.0 + s->plan / s->way;
    const double a = x * x * x * (10.0 + x * (6.0 * x - 15.0)), b = 30.0 * x * x * (1.0 - x) * (1.0 - x) / s->way;
    for (j = 0; j < PLAYER_JOINTS; ++j) {
      const double apart = player_q[first][j] - s->from[j];
      q_ref[j] = s->from[j] + a * apart;
      qd_ref[j] = b * apart;
    }
    return;
  }
  {
    const double at = s->plan * PLAYER_RATE_HZ, h = 1.0 / PLAYER_RATE_HZ;
    const int over = at >= (double)(last - first);
    const unsigned k = over ? last : first + (unsigned)at, next = over ? last : k + 1u;
    const double u = over ? 0.0 : at - floor(at), v = 1.0 - u;
    for (j = 0; j < PLAYER_JOINTS; ++j) {
      const double p = player_q[k][j], pd = h * player_qd[k][j], r = player_q[next][j], rd = h * player_qd[next][j];
      q_ref[j] = v * v * ((1.0 + 2.0 * u) * p + u * pd) + u * u * ((3.0 - 2.0 * u) * r - v * rd);
      qd_ref[j] = over ? 0.0 : s->speed * (6.0 * u * v * (r - p) + v * (1.0 - 3.0 * u) * pd + u * (3.0 * u - 2.0) * rd) / h;
    }
  }
}

static void player_record(player_state *s, const double q[PLAYER_JOINTS], const double tau[PLAYER_JOINTS],
                          const double q_ref[PLAYER_JOINTS]) {
  const unsigned written = s->written;
  int j;
  if (written - s->taken >= PLAYER_RECORDS) {
    s->lost += 1u;
    return;
  }
  {
    player_row *row = &s->rows[written & (PLAYER_RECORDS - 1u)];
    row->number = s->steps;
    row->status = s->status;
    row->motion = s->motion;
    row->t = s->t;
    row->plan = s->plan;
    for (j = 0; j < PLAYER_JOINTS; ++j) {
      row->q[j] = q[j];
      row->q_ref[j] = q_ref[j];
      row->tau[j] = tau[j];
    }
  }
  s->written = written + 1u; /* after the row, for a reader in another thread of the same core; else add a fence */
}

/* One period of the loop. Writes references and the share of the torque; returns the status. */
int player_step(player_state *s, double dt, const double q[PLAYER_JOINTS], const double tau[PLAYER_JOINTS],
                double q_ref[PLAYER_JOINTS], double qd_ref[PLAYER_JOINTS], double *share) {
  const double total = (double)(player_begin[s->motion + 1] - 1u - player_begin[s->motion]) / PLAYER_RATE_HZ;
  int j, moving = s->status == PLAYER_APPROACHING || s->status == PLAYER_PLAYING;
  *share = 0.0;
  if (s->status == PLAYER_IDLE) {
    for (j = 0; j < PLAYER_JOINTS; ++j) {
      q_ref[j] = q[j];
      qd_ref[j] = 0.0;
    }
    return s->status;
  }
  if (!isfinite(dt) || dt < 0.0) {
    player_fault(s, PLAYER_NOT_FINITE, -1);
    dt = 0.0;
  } else if (dt > PLAYER_LATE && s->steps) {
    player_fault(s, PLAYER_TOO_LATE, -1);
  }
  moving = moving && s->status != PLAYER_STOPPED;
  s->t += dt;
  if (moving) s->plan += s->plan < 0.0 ? dt : s->speed * dt;
  if (s->status == PLAYER_APPROACHING && s->plan >= 0.0) s->status = PLAYER_PLAYING;
  if (s->status == PLAYER_PLAYING && s->plan >= total) {
    s->plan = total;
    s->status = PLAYER_DONE;
  }
  player_reference(s, q_ref, qd_ref);
  for (j = 0; j < PLAYER_JOINTS; ++j) {
    if (!isfinite(q[j])) {
      player_fault(s, PLAYER_NOT_FINITE, j);
      continue;
    }
    if (dt > 0.0 && s->steps) { /* a low-pass of 10 ms: quantised positions have no velocity from one period */
      const double keep = exp(-dt / 0.01);
      s->rate[j] = keep * s->rate[j] + (1.0 - keep) * (q[j] - s->last[j]) / dt;
    }
    s->last[j] = q[j];
    if (fabs(s->rate[j]) > player_fastest[j]) player_fault(s, PLAYER_TOO_FAST, j);
    if (s->plan >= 0.0 && (q[j] < player_low[j] || q[j] > player_high[j])) player_fault(s, PLAYER_OUT_OF_RANGE, j);
    if (fabs(q_ref[j] - q[j]) > PLAYER_TRACKING) player_fault(s, PLAYER_TRACKING_ERROR, j);
  }
  if (s->status == PLAYER_STOPPED) {
    for (j = 0; j < PLAYER_JOINTS; ++j) {
      q_ref[j] = s->last[j]; /* the damping of the user's controller brakes */
      qd_ref[j] = 0.0;
    }
    s->share = s->reason == PLAYER_NOT_FINITE ? 0.0 : fmax(0.0, s->share - dt / PLAYER_FADE);
  } else {
    s->share = fmin(1.0, s->share + dt / PLAYER_FADE);
  }
  *share = s->share;
  player_record(s, q, tau, q_ref);
  s->steps += 1u;
  return s->status;
}

/* Take up to `many` recorded rows, oldest first; returns their number. */
unsigned player_read(player_state *s, player_row *rows, unsigned many) {
  unsigned k = 0u;
  while (k < many && s->taken != s->written) {
    rows[k++] = s->rows[s->taken & (PLAYER_RECORDS - 1u)];
    s->taken += 1u;
  }
  return k;
}

#ifdef PLAYER_STDIO
/* Write rows as CSV, with a head before the first one. */
void player_print(FILE *file, const player_row *rows, unsigned many, int head) {
  unsigned k;
  int j;
  if (head) {
    fprintf(file, "number,status,motion,t,plan");
    for (j = 0; j < PLAYER_JOINTS; ++j) fprintf(file, ",q%d,ref%d,tau%d", j + 1, j + 1, j + 1);
    fprintf(file, "\n");
  }
  for (k = 0u; k < many; ++k) {
    fprintf(file, "%u,%d,%d,%.9g,%.9g", rows[k].number, rows[k].status, rows[k].motion, rows[k].t, rows[k].plan);
    for (j = 0; j < PLAYER_JOINTS; ++j)
      fprintf(file, ",%.12g,%.12g,%.12g", rows[k].q[j], rows[k].q_ref[j], rows[k].tau[j]);
    fprintf(file, "\n");
  }
}
#endif
