/*
 * Desired poses in, commands out. Build: cc -O3 {{ name }}.c {{ name }}_main.c -lm -o {{ name }}
 *
 *   {{ name }} < poses.txt             a line each: x y z [m] qx qy qz qw; out: the readings, what the call returned,
 *                                      iterations, estimated error, share of the correction
 *   {{ name }} --predict < joints.txt  a line each: the readings; out: x y z qx qy qz qw, and the same four
 *   {{ name }} --time N < poses.txt    microseconds a command, N times through all poses (the first 4096)
 */
#include "{{ name }}.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define POSES 4096

static double poses[POSES][7];

static int read_numbers(double *numbers, int n) {
  int i;
  for (i = 0; i < n; ++i)
    if (scanf("%lf", &numbers[i]) != 1) return 0;
  return 1;
}

static void say(const double *numbers, int n, int flags, const {{ name }}_status *status) {
  int i;
  for (i = 0; i < n; ++i) printf("%.17g ", numbers[i]);
  printf("%d %d %.3g %.17g\n", flags, status->iterations, status->error, status->share);
}

/* Mean microseconds a call; cold: every search starts at home, else where the pose before was found. */
static void measure(int n, int rounds, int cold) {
  {{ name }}_state state;
  {{ name }}_status status;
  double command[{{ NAME }}_ACTUATORS], sum = 0;
  long iterations = 0, lost = 0;
  clock_t began;
  int k, r;
  {{ name }}_start(&state);
  began = clock();
  for (r = 0; r < rounds; ++r)
    for (k = 0; k < n; ++k) {
      if (cold) {{ name }}_start(&state);
      lost += ({{ name }}_command(poses[k], poses[k] + 3, &state, command, &status) & 3) != 0;
      iterations += status.iterations;
      sum += command[0];
    }
  printf("%s %.3f us a command, %.2f iterations, %ld not reached (sum %.6g)\n", cold ? "cold" : "warm",
    1e6 * (double)(clock() - began) / CLOCKS_PER_SEC / ((double)n * rounds), (double)iterations / ((double)n * rounds),
    lost, sum);
}

int main(int count, char **arguments) {
  {{ name }}_state state;
  {{ name }}_status status = {0, 0, 0};
  double given[7 + {{ NAME }}_ACTUATORS];
  int i, flags;
  if (count > 2 && !strcmp(arguments[1], "--time")) {
    int n = 0, rounds = atoi(arguments[2]);
    while (n < POSES && read_numbers(poses[n], 7)) ++n;
    if (n < 1 || rounds < 1) return 2;
    measure(n, rounds, 1);
    measure(n, rounds, 0);
    return 0;
  }
  if (count > 1 && !strcmp(arguments[1], "--predict")) {
    while (read_numbers(given, {{ NAME }}_ACTUATORS)) {
      double pose[7] = {NAN, NAN, NAN, NAN, NAN, NAN, NAN};
      flags = {{ name }}_predict(given, pose, pose + 3, &status);
      say(pose, 7, flags, &status);
    }
    return 0;
  }
  if (count > 1) return 2;
  printf("#");
  for (i = 0; i < {{ NAME }}_ACTUATORS; ++i) printf(" %s", {{ name }}_names[i]);
  printf(" flags iterations error share\n");
  {{ name }}_start(&state);
  while (read_numbers(given, 7)) {
    double command[{{ NAME }}_ACTUATORS];
    for (i = 0; i < {{ NAME }}_ACTUATORS; ++i) command[i] = NAN;
    flags = {{ name }}_command(given, given + 3, &state, command, &status);
    say(command, {{ NAME }}_ACTUATORS, flags, &status);
  }
  return 0;
}
