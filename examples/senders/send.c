/* Sends samples to the live page of the workbench as frames by UDP, for controllers in C or C++.

   cc -O2 -o send send.c -lm && ./send 127.0.0.1 PORT

   Copy frame_of() and the sendto() into your control loop; call it once a sample, or with some samples at a time. */
#include <arpa/inet.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>

enum { POSITIONS = 2, TORQUES = 2, LARGEST = 16 + 8 * (POSITIONS + TORQUES) };

static void little(unsigned char *at, uint64_t value, int bytes) {
  for (int k = 0; k < bytes; k++) at[k] = (unsigned char)(value >> (8 * k));
}

/* One sample as a frame of version 1; its length in bytes. */
static size_t frame_of(unsigned char *frame, uint32_t number, const double *position, const double *torque) {
  memcpy(frame, "HPTF\1\0", 6);
  little(frame + 6, POSITIONS, 2);
  little(frame + 8, TORQUES, 2);
  little(frame + 10, 1, 2); /* samples in this frame */
  little(frame + 12, number, 4);
  for (int k = 0; k < POSITIONS + TORQUES; k++) {
    double value = k < POSITIONS ? position[k] : torque[k - POSITIONS];
    uint64_t bits;
    memcpy(&bits, &value, 8);
    little(frame + 16 + 8 * k, bits, 8);
  }
  return LARGEST;
}

int main(int count, char **words) {
  if (count < 3) return fprintf(stderr, "usage: send ADDRESS PORT [SAMPLES]\n"), 2;
  struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons((uint16_t)atoi(words[2]))};
  if (inet_pton(AF_INET, words[1], &to.sin_addr) != 1) return fprintf(stderr, "not an address: %s\n", words[1]), 2;
  int out = socket(AF_INET, SOCK_DGRAM, 0);
  if (out < 0) return perror("socket"), 1;
  long samples = count > 3 ? atol(words[3]) : 60000;
  struct timespec next;
  clock_gettime(CLOCK_MONOTONIC, &next);
  for (long number = 0; number < samples; number++) {
    double t = 1e-3 * (double)number; /* in place of these: what your controller has measured and commanded */
    double position[POSITIONS] = {0.5 * sin(t), 0.5 * sin(1.3 * t)}, torque[TORQUES] = {cos(t), cos(1.3 * t)};
    unsigned char frame[LARGEST];
    size_t length = frame_of(frame, (uint32_t)number, position, torque);
    sendto(out, frame, length, 0, (struct sockaddr *)&to, sizeof to);
    next.tv_nsec += 1000000;
    if (next.tv_nsec >= 1000000000) next.tv_nsec -= 1000000000, next.tv_sec++;
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, NULL);
  }
  return 0;
}
