// One tick of the flight controller of a jet-powered humanoid robot, for C and C++. Generated from rust/capi/src.
//
// SI units and radians. Inertial axes: x forward, y left, z up. Matrices are stored by rows. Arrays of joints and
// jets are in the order of the robot's TOML file; flight_joint_name and flight_jet_name return it.

#ifndef FLIGHT_H
#define FLIGHT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

// Outcome of a call.
typedef enum FlightStatus {
  // The command is that of the control law: both QPs are solved and certified.
  FLIGHT_NOMINAL = 0,
  // The measurement is not of this robot: thrust rates and joint velocities are zero, torques keep their values.
  FLIGHT_BAD_MEASUREMENT = 1,
  // The set-point exceeds the accepted range (`channels.greatest`), or its matrix is not a rotation: the robot brakes
  // from the motion of the last valid one.
  FLIGHT_BAD_SETPOINT = 2,
  // The momentum QP has no answer: thrust rates and joint velocities are as near to zero as their bounds allow.
  FLIGHT_MOMENTUM_HELD = 3,
  // The torque QP has no answer: torques keep their values.
  FLIGHT_TORQUE_HELD = 4,
  // Neither QP has an answer.
  FLIGHT_BOTH_HELD = 5,
  // The command is that of the control law, but part of the measurement is predicted (NaN marks what is not
  // measured) or the robot descends.
  FLIGHT_DEGRADED = 6,
  // No flight has been started, or none can start with this measurement. No command is written.
  FLIGHT_NOT_STARTED = -1,
  // A required pointer is null. No command is written.
  FLIGHT_NULL_POINTER = -2,
  // Internal error of the library. Thrust rates and joint velocities are zero; the torques in the command are
  // unchanged.
  FLIGHT_PANICKED = -3,
  // A replaced command contains a number that is not finite. Nothing changes.
  FLIGHT_BAD_COMMAND = -4,
} FlightStatus;

// A controller with its flight. Not to be used by several threads at the same time.
typedef struct FlightController FlightController;

// Measurement of a tick.
typedef struct FlightMeasurement {
  // Time since the start of the flight [s].
  double time;
  // Position of the base origin [m, inertial axes].
  double base_position[3];
  // Rotation from base to inertial axes, by rows.
  double base_rotation[9];
  // Velocity of the base origin [m/s, inertial axes].
  double base_linear_velocity[3];
  // Angular velocity of the base [rad/s, inertial axes].
  double base_angular_velocity[3];
  // Joint positions [rad], one per joint.
  const double *joint_position;
  // Joint velocities [rad/s], one per joint; NaN where they are not measured, which requires
  // `controller.estimator.joint_observer`.
  const double *joint_velocity;
  // Thrusts [N], one per jet.
  const double *thrust;
  // Velocity of the air [m/s, inertial axes]; NaN if it is not measured. Zero means measured still air: without a
  // wind sensor use `controller.wind_observer`, or a controller without aerodynamic model.
  double wind[3];
  // Wrench on each foot about the origin of its sole, force first [N, N m, inertial axes], six per foot, in the
  // order of `controller.contact.feet`. NaN where it is not measured; null means that no load is measured on any
  // foot.
  const double *foot_wrenches;
} FlightMeasurement;

// Set-point of a tick, for programs with their own planner.
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

// Arrays of the caller to which a tick writes its command, which is valid until the next tick.
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

// Creates the controller of a flight configuration, a file as in `configs/experiments/`.
//
// Returns null on failure; `message`, unless null, then contains the reason in at most `message_size` bytes, the last
// of which is zero. Allocates.
//
// # Safety
// `path` is a zero-terminated string, or null; `message` has space for `message_size` bytes.
struct FlightController *flight_controller_create(const char *path,
                                                  char *message,
                                                  size_t message_size);

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

// Number of feet on which the controller stands, `controller.contact.feet`; zero for null.
//
// # Safety
// As for `flight_joint_count`.
size_t flight_foot_count(const struct FlightController *controller);

// Name of a joint, valid as long as the controller exists; null beyond the last joint.
//
// # Safety
// As for `flight_joint_count`.
const char *flight_joint_name(const struct FlightController *controller, size_t index);

// Name of a jet, valid as long as the controller exists; null beyond the last jet.
//
// # Safety
// As for `flight_joint_count`.
const char *flight_jet_name(const struct FlightController *controller, size_t index);

// Time between two ticks [s]; zero for null.
//
// # Safety
// As for `flight_joint_count`.
double flight_time_step(const struct FlightController *controller);

// Ways in which the last tick differs from one with complete measurements, as a sum: wind held 1 or lost 2; predicted
// thrust 4, joints 8, base position 16, base rotation 32, base velocity 64, foot wrenches 128, clock 256; descent 512;
// an engine does not reach its thrust 1024. Zero for null.
//
// # Safety
// As for `flight_joint_count`.
uint32_t flight_modes(const struct FlightController *controller);

// Starts a flight, in place of the present one if any: position, attitude and posture of this measurement become the
// reference. Only the wind may be NaN, and joint velocities that need not be measured. If no flight can start with it,
// the present one continues. Allocates, so call it before the control loop.
//
// # Safety
// `measurement` is null or points to one whose arrays have the documented lengths.
enum FlightStatus flight_start(struct FlightController *controller,
                               const struct FlightMeasurement *measurement);

// Computes one tick, which follows the mission of the configuration, or `setpoint` unless it is null.
//
// # Safety
// The pointers are null or point to objects of their types; the arrays of `measurement` and `command` have the
// documented lengths.
enum FlightStatus flight_tick(struct FlightController *controller,
                              const struct FlightMeasurement *measurement,
                              const struct FlightSetpoint *setpoint,
                              const struct FlightCommand *command);

// Reports after a tick that other thrust rates and joint torques act until the next one, such as those of a safety
// layer or of a motor at its limit. The controller's predictions use them; joint velocities are not read.
//
// # Safety
// The pointers are null or point to objects of their types; the arrays of `command` have the documented lengths.
enum FlightStatus flight_replace_command(struct FlightController *controller,
                                         const struct FlightCommand *command);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* FLIGHT_H */
