/* {{ said | join("\n * ") }}
 *
 * From a desired pose in the measurement frame to the actuators' readings that reach it. No memory is allocated, nothing
 * is kept between calls but what the caller holds, and no loop runs longer than the constants below say.
 */
#ifndef {{ NAME }}_H
#define {{ NAME }}_H

#ifdef __cplusplus
extern "C" {
#endif

#define {{ NAME }}_ACTUATORS {{ actuators }}
#define {{ NAME }}_JOINTS {{ joints }}
#define {{ NAME }}_PASSIVE {{ passive }}
#define {{ NAME }}_ITERATIONS {{ most.inverse + most.hybrid }} /* of a command, at most */

/* What a call returns: 0, or a sum of these. A command that did not converge, or on another branch, is not written. */
#define {{ NAME }}_NOT_CONVERGED 1     /* the pose can't be reached, or the start is too far from it */
#define {{ NAME }}_OTHER_BRANCH 2      /* behind a singularity */
#define {{ NAME }}_BEYOND_LIMITS 4     /* of a joint, passive ones included */
#define {{ NAME }}_OUTSIDE_WORKSPACE 8 /* of robot.toml: its conditioning was never checked there */

/* Where the last command was found: the next search starts there. Begin with {{ name }}_start, a state for each robot. */
typedef struct {
  double joints[{{ joints }}];
  double apart[{{ [passive, 1] | max }}]; /* of the passive joints, with the correction less without */
} {{ name }}_state;

typedef struct {
  int iterations;
  double error; /* of a joint [m or rad]: what the last step is estimated to leave */
  double share; /* of the correction that is believed there: 0 outside the measured poses */
} {{ name }}_status;

/* Actuators, in the order of commands; a reading has the actuator's own unit. */
extern const char *const {{ name }}_names[{{ actuators }}];

/* At home; a state that has failed starts there again by itself. */
void {{ name }}_start({{ name }}_state *state);

/*
 * position: x, y, z [m]; quaternion: x, y, z, w, of any length.
 * {{ poses | join("\n * ") }}
 */
int {{ name }}_command(const double position[3], const double quaternion[4], {{ name }}_state *state,
  double command[{{ actuators }}], {{ name }}_status *status);

/* The pose at given readings, from home's assembly branch. It is written where the loops close there. */
int {{ name }}_predict(const double readings[{{ actuators }}], double position[3], double quaternion[4],
  {{ name }}_status *status);

/* Of R = Rz(yaw) Ry(pitch) Rx(roll) [rad]. */
void {{ name }}_quaternion(double roll, double pitch, double yaw, double quaternion[4]);

#ifdef __cplusplus
}
#endif
#endif
