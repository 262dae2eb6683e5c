// One tick of the flight controller of a jet-powered humanoid robot, for C and C++. Generated from rust/capi/src.
//
// SI units and radians. Inertial axes: x forward, y left, z up. Matrices are stored by rows. Arrays of joints and
// jets are in the order of the robot's TOML file; flight_joint_name and flight_jet_name return it.

#ifndef FLIGHT_H
#define FLIGHT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

// How a call ended.
typedef enum FlightStatus {
  // The command is the one that the control law gives: both QPs solved and certified.
  FLIGHT_NOMINAL = 0,
  // The measurement is not of this robot: thrust rates and joint velocities are zero, torques stay.
  FLIGHT_BAD_MEASUREMENT = 1,
  // The set-point is beyond what is accepted of a robot (`channels.greatest`) or its rotation is none: the robot brakes from the motion of the last one.
  FLIGHT_BAD_SETPOINT = 2,
  // The momentum QP has no answer: thrust rates and joint velocities are as near to zero as their bounds allow.
  FLIGHT_MOMENTUM_HELD = 3,
  // The torque QP has no answer: torques stay.
  FLIGHT_TORQUE_HELD = 4,
  // Neither QP has an answer.
  FLIGHT_BOTH_HELD = 5,
  // The command of the control law for a measurement of which something had to be predicted (NaN stands for what is
  // not measured), or on the way down.
  FLIGHT_DEGRADED = 6,
  // No flight has been started, or it cannot begin with this measurement. No command is written.
  FLIGHT_NOT_STARTED = -1,
  // A pointer that must not be null is. No command is written.
  FLIGHT_NULL_POINTER = -2,
  // An error of the library. Thrust rates and joint velocities are zero, torques stay as the caller has them.
  FLIGHT_PANICKED = -3,
  // A replaced command holds a number that is not finite. Nothing changes.
  FLIGHT_BAD_COMMAND = -4,
} FlightStatus;

// A controller and the flight it is in. One thread at a time may use it.
typedef struct FlightController FlightController;

// What is measured at a tick.
typedef struct FlightMeasurement {
  // Time since the flight began [s].
  double time;
  // Origin of the base [m].
  double base_position[3];
  // Rotation from base to inertial axes, by rows.
  double base_rotation[9];
  // Velocity of the base's origin [m/s, inertial axes].
  double base_linear_velocity[3];
  // Angular velocity of the base [rad/s, inertial axes].
  double base_angular_velocity[3];
  // Joint positions [rad], one per joint.
  const double *joint_position;
  // Joint velocities [rad/s], one per joint; NaN where they are not measured, which
  // `controller.estimator.joint_observer` makes up for.
  const double *joint_velocity;
  // Thrusts [N], one per jet.
  const double *thrust;
  // Velocity of the air [m/s, inertial axes]; NaN where it is not measured. Zero is still air, as if
  // measured: without a wind sensor use `controller.wind_observer`, or a controller without aerodynamic model.
  double wind[3];
  // Wrench on each foot about the origin of its sole, force first [N, N m, inertial axes], six per
  // foot, in the order of `controller.contact.feet`. NaN where they are not measured; null is no load on any foot, as if
  // measured.
  const double *foot_wrenches;
} FlightMeasurement;

// What the robot is to do, for a program that plans by itself.
typedef struct FlightSetpoint {
  // Centre of mass [m].
  double com_position[3];
  // Its velocity [m/s].
  double com_velocity[3];
  // Its acceleration [m/s²].
  double com_acceleration[3];
  // Its jerk [m/s³].
  double com_jerk[3];
  // Rotation from base to inertial axes, by rows.
  double rotation[9];
  // Angular velocity of the base [rad/s, body axes].
  double angular_velocity[3];
  // Angular acceleration of the base [rad/s², body axes].
  double angular_acceleration[3];
  // Angular jerk of the base [rad/s³, body axes].
  double angular_jerk[3];
} FlightSetpoint;

// Where a tick writes its command, which holds until the next tick. The arrays are the caller's.
typedef struct FlightCommand {
  // Thrust rates [N/s], one per jet.
  double *thrust_rate;
  // Joint velocities [rad/s], one per joint.
  double *joint_velocity;
  // Joint torques [N m], one per joint.
  double *joint_torque;
} FlightCommand;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Creates the controller of a flight's configuration: a file as in `configs/experiments/`.
//
// Returns null if it cannot be made; `message`, unless null, then holds the reason: at most
// `message_size` bytes, the last of them zero. Allocates.
//
// # Safety
// `path` is a string that ends with a zero byte, or null; `message` has space for `message_size` bytes.
struct FlightController *flight_controller_create(const char *path, char *message, size_t message_size);

// Frees a controller; null is allowed.
//
// # Safety
// `controller` comes from `flight_controller_create` and is not used afterwards.
void flight_controller_free(struct FlightController *controller);

// Number of joints; zero for null.
//
// # Safety
// `controller` comes from `flight_controller_create`, or is null. The same holds for every function below.
size_t flight_joint_count(const struct FlightController *controller);

// Number of jets; zero for null.
//
// # Safety
// As for `flight_joint_count`.
size_t flight_jet_count(const struct FlightController *controller);

// Number of feet that the controller stands on, `controller.contact.feet`; zero for null.
//
// # Safety
// As for `flight_joint_count`.
size_t flight_foot_count(const struct FlightController *controller);

// Name of a joint, which lives as long as the controller; null beyond the last.
//
// # Safety
// As for `flight_joint_count`.
const char *flight_joint_name(const struct FlightController *controller, size_t index);

// Name of a jet, which lives as long as the controller; null beyond the last.
//
// # Safety
// As for `flight_joint_count`.
const char *flight_jet_name(const struct FlightController *controller, size_t index);

// Seconds between two ticks; zero for null.
//
// # Safety
// As for `flight_joint_count`.
double flight_time_step(const struct FlightController *controller);

// In which ways the last tick differs from one that measures everything, as a sum: the wind is 1 held, 2 lost; 4 a thrust,
// 8 the joints, 16 base position, 32 its rotation, 64 its velocity, 128 the wrenches on the feet are predicted;
// 256 the clock is predicted; 512 on the way down; 1024 an engine does not reach its thrust. Zero for null.
//
// # Safety
// As for `flight_joint_count`.
uint32_t flight_modes(const struct FlightController *controller);

// Begins a flight: position, attitude and posture of this measurement are those to keep. Allocates, so
// it is called before the loop; a flight under way ends.
//
// # Safety
// `measurement` is null or points to one whose arrays have the lengths that are stated there.
enum FlightStatus flight_start(struct FlightController *controller,
                               const struct FlightMeasurement *measurement);

// One tick, which follows the mission of the configuration, or `setpoint` where it is not null.
//
// # Safety
// The pointers are null or point to what their types say; the arrays of `measurement` and `command` have
// the lengths that are stated there.
enum FlightStatus flight_tick(struct FlightController *controller,
                              const struct FlightMeasurement *measurement,
                              const struct FlightSetpoint *setpoint,
                              const struct FlightCommand *command);

// Reports after a tick other thrust rates and joint torques that act until the next one: those of a safety layer, or of a
// motor at its limit. What the controller predicts follows them; joint velocities are not read.
//
// # Safety
// The pointers are null or point to what their types say; the arrays of `command` have the lengths that are stated there.
enum FlightStatus flight_replace_command(struct FlightController *controller,
                                         const struct FlightCommand *command);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* FLIGHT_H */
