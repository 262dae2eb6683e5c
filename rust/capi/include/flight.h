// One tick of the flight controller of a jet-powered humanoid robot, for C and C++. Generated from rust/capi/src.
//
// SI units and radians. Inertial axes: x forward, y left, z up. Matrices are stored by rows. Arrays of joints and
// jets are in the order of the robot's TOML file; flight_joint_name and flight_jet_name return it.
//
// A controller is used by one thread at a time, any thread: flight_tick and flight_tick_torques of one controller must not
// overlap, so a fast thread of the torques waits for a tick of the law, or calls both. Different controllers share nothing.
// Names and counts may be read at any time. Rounding must be to nearest and subnormal numbers must not be flushed to zero in
// every thread that calls a tick (flight_start checks its own thread); floating-point traps must be off.

#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

// What in a tick is not as usual; `flight_modes` is a sum of them.
typedef enum FlightMode {
  // The wind is the last measured one, held or fading.
  FLIGHT_WIND_HELD = 1,
  // The wind has been missing for so long that still air is assumed.
  FLIGHT_WIND_LOST = 2,
  // A thrust is predicted by the model of the jet.
  FLIGHT_THRUST_MODELLED = 4,
  // Joint positions and velocities are predicted by the model.
  FLIGHT_JOINTS_PREDICTED = 8,
  // The base position is predicted by the model.
  FLIGHT_POSITION_PREDICTED = 16,
  // The base rotation is predicted by the model.
  FLIGHT_ROTATION_PREDICTED = 32,
  // The base velocity is predicted by the model, or follows the pose.
  FLIGHT_VELOCITY_PREDICTED = 64,
  // The foot wrenches are those that keep the feet at rest in the model.
  FLIGHT_FEET_PREDICTED = 128,
  // The time is the controller's own, because the clock is missing or has jumped.
  FLIGHT_CLOCK_PREDICTED = 256,
  // The robot levels and descends instead of following its mission.
  FLIGHT_DESCENDING = 512,
  // An engine does not reach its commanded thrust.
  FLIGHT_ENGINE_LIMITED = 1024,
  // The first measurements are outvoted: the flight begins again from those of this tick.
  FLIGHT_BEGUN_AGAIN = 2048,
  // A joint does not follow its torque.
  FLIGHT_JOINT_LIMITED = 4096,
  // The measurement is not of this robot: thrust rates and joint velocities are zero, torques keep their values.
  FLIGHT_MEASUREMENT_IGNORED = 8192,
  // The flight is too far from its set-point, or its joints are too fast.
  FLIGHT_TRACKING_ERROR = 16384,
  // The residual of a policy, or a given one, is not finite and not used.
  FLIGHT_RESIDUAL_IGNORED = 32768,
  // Commands act later or earlier than the controller knows.
  FLIGHT_LATE = 65536,
  // The state is of another controller; the command is as for an ignored measurement.
  FLIGHT_STATE_IGNORED = 131072,
  // The given set-point exceeds the accepted range, or its matrix is not a rotation: the robot brakes from the motion of the last valid one.
  FLIGHT_SETPOINT_IGNORED = 262144,
  // Set-points or winds of the preview exceed the accepted range, or their times do not increase: none is used.
  FLIGHT_PREVIEW_IGNORED = 524288,
  // The predictive law has no new certified plan: it follows the last one.
  FLIGHT_PLAN_KEPT = 1048576,
  // The predictive law has no certified plan: the momentum QP decides.
  FLIGHT_PLAN_MISSING = 2097152,
  // The momentum QP has no answer: thrust rates and joint velocities are as near to zero as their bounds allow; the torques brake the joints.
  FLIGHT_MOMENTUM_HELD = 4194304,
  // The torque QP has no answer: torques keep their values.
  FLIGHT_TORQUE_HELD = 8388608,
  // An engine whose thrust is not measured has stopped, as the momentum shows.
  FLIGHT_ENGINE_STOPPED = 16777216,
  // The height above the ground has not been measured for 0.15 s: the ground is where it was found last.
  FLIGHT_GROUND_HELD = 33554432,
} FlightMode;

// Version of the library to which this header belongs: 10000 major + 100 minor + patch.
#define FLIGHT_VERSION 200

// Greatest thrust rate and torque that a simulated robot accepts \[N/s, N m\].
#define FLIGHT_COMMAND_MAX 1e6

// Of the set-points and of the winds of a `FlightPreview` so many are read, the first ones.
#define FLIGHT_PREVIEW_MAX 128

// Outcome of a call; below zero an error.
typedef enum FlightStatus {
  // Done; of a tick `flight_modes` says what is not as usual.
  FLIGHT_OK = 0,
  // No flight has been started, or none can start with this measurement. No command is written.
  FLIGHT_NOT_STARTED = -1,
  // A required pointer is null. Nothing is written.
  FLIGHT_NULL_POINTER = -2,
  // Internal error of the library. Thrust rates and joint velocities are zero; the torques in the command are
  // unchanged.
  FLIGHT_PANICKED = -3,
  // A replaced command has a number beyond what drives and engines can follow, or one for a simulated robot a number
  // that is not finite or exceeds `FLIGHT_COMMAND_MAX`. Nothing changes.
  FLIGHT_BAD_COMMAND = -4,
  // The motion of the simulated robot has no meaning any more: its numbers are not finite, or beyond any robot's.
  FLIGHT_DIVERGED = -5,
} FlightStatus;

// A controller with its flight, for one thread at a time; several threads may read it (functions that take a pointer
// to const) while none changes it.
typedef struct FlightController FlightController;

// A simulated robot in the wind of its configuration, for one thread at a time. Its measurements are exact: neither
// `simulator.sensors` nor errors and outages of `disturbances` apply. Commands are delayed by `simulator.actuation`.
typedef struct FlightRobot FlightRobot;

// Version and sizes with which a program was compiled, from `flight_header`.
typedef struct FlightHeader {
  // `FLIGHT_VERSION`
  uint32_t version;
  // `sizeof(FlightMeasurement)`
  size_t measurement_size;
  // `sizeof(FlightSetpoint)`
  size_t setpoint_size;
  // `sizeof(FlightPreview)`
  size_t preview_size;
  // `sizeof(FlightCommand)`
  size_t command_size;
} FlightHeader;

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
  // Speeds of the shafts, shares of the full speed, one per jet; NaN where they are not measured, null for none. Only a
  // controller with `controller.shaft` reads them: the thrust follows from the speed.
  const double *shaft_speed;
  // Height of the base origin above that on the ground on which the robot is to land, in the posture in which the flight
  // begins [m]; NaN where it is not measured.
  double height;
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

// What is known of the future at a tick, for `flight_tick_ahead`; only the predictive law (`controller.mpc`) reads it.
// Times are those after the tick [s], increasing.
typedef struct FlightPreview {
  // Number of set-points that follow the given one; zero for none.
  size_t setpoint_count;
  // Their times, above zero.
  const double *setpoint_time;
  // The set-points: interpolated between, extrapolated after the last one.
  const struct FlightSetpoint *setpoint;
  // Number of winds; zero for none.
  size_t wind_count;
  // Their times, from zero on.
  const double *wind_time;
  // Velocities of the air [m/s, inertial axes], three per time: linear between, constant outside. The prediction has
  // their change from time zero.
  const double *wind;
} FlightPreview;

// Torques of a part of a tick, for `flight_robot_advance_in_steps`: receives the number of the part, from one, positions
// and velocities of the joints then [rad, m; rad/s, m/s], and what was given with the function; writes the torques
// [N m, N], which are those of the part before.
typedef void (*FlightTorques)(uint32_t part,
                              const double *joint_position,
                              const double *joint_velocity,
                              double *joint_torque,
                              void *context);

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Version of this library, as `FLIGHT_VERSION`.
uint32_t flight_version(void);

// Name of a `FlightStatus`, such as `null_pointer`; null for other numbers.
const char *flight_status_name(int status);

// Name of a `FlightMode`, such as `wind_held`; null for other numbers.
const char *flight_mode_name(uint32_t mode);

// Creates the controller of a file as in `configs/onboard/`, which names no simulator, or as in `configs/experiments/`, with
// the errors that its `disturbances` give the controller's models. Allocates.
//
// `header` is `flight_header()`. Returns null on failure, also if the program was compiled with the header of another
// library; `message`, unless null, then contains the reason in at most `message_size` bytes, the last of which is zero.
//
// # Safety
// `path` is a zero-terminated string, or null; `message` is null or has space for `message_size` bytes.
struct FlightController *flight_controller_create(struct FlightHeader header,
                                                  const char *path,
                                                  char *message,
                                                  size_t message_size);

// Frees a controller; null is allowed. No thread may use it then or later, nor free it again: it is not guarded against.
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

// Times that torques are computed in a tick, `controller.torque.steps`; zero for null.
//
// # Safety
// As for `flight_joint_count`.
uint32_t flight_torque_steps(const struct FlightController *controller);

// What in the last tick was not as usual, a sum of `FlightMode`; zero for null.
//
// # Safety
// As for `flight_joint_count`.
uint32_t flight_modes(const struct FlightController *controller);

// Whether thrust rates, torques or both of the last tick are not those of the control law; true for null.
//
// # Safety
// As for `flight_joint_count`.
bool flight_is_held(const struct FlightController *controller);

// Throttle \[%\] with which a jet's engine follows the thrust rate of the last tick, for robots whose engines take no
// rates. Zero with `controller.jet_dynamics = "ideal"`, which has no engines, for null or an index outside of the range.
//
// # Safety
// As for `flight_joint_count`.
double flight_throttle(const struct FlightController *controller,
                       size_t index);

// Starts a flight, in place of the present one if any: position, attitude and posture of this measurement become the
// reference. Only wind, height and speeds of shafts may be NaN, thrusts of jets whose speed is measured, and joint
// velocities that need not be measured; in later ticks any number may be, where it is not measured. If no flight can start with it,
// the present one continues, and `message`, unless null, contains the reason in at most `message_size` bytes, the last
// of which is zero. Allocates, so call it before the control loop.
//
// # Safety
// `measurement` is null or points to one whose arrays have the documented lengths; `message` is null or has space for
// `message_size` bytes.
enum FlightStatus flight_start(struct FlightController *controller,
                               const struct FlightMeasurement *measurement,
                               char *message,
                               size_t message_size);

// Computes one tick, which follows the mission of the configuration, or `setpoint` unless it is null. Allocates only where
// `controller.qp` selects Clarabel.
//
// # Safety
// The pointers are null or point to objects of their types; the arrays of `measurement` and `command` have the
// documented lengths.
enum FlightStatus flight_tick(struct FlightController *controller,
                              const struct FlightMeasurement *measurement,
                              const struct FlightSetpoint *setpoint,
                              const struct FlightCommand *command);

// As `flight_tick`, with what is known of the future, unless `preview` is null.
//
// # Safety
// As for `flight_tick`; `preview` is null or points to one whose arrays have the documented lengths.
enum FlightStatus flight_tick_ahead(struct FlightController *controller,
                                    const struct FlightMeasurement *measurement,
                                    const struct FlightSetpoint *setpoint,
                                    const struct FlightPreview *preview,
                                    const struct FlightCommand *command);

// Reports after a tick that other thrust rates and joint torques act until the next one, such as those of a safety
// layer or of a motor at its limit. The controller's predictions use them; joint velocities are not read.
//
// # Safety
// The pointers are null or point to objects of their types; the arrays of `command` have the documented lengths.
enum FlightStatus flight_replace_command(struct FlightController *controller,
                                         const struct FlightCommand *command);

// One tick of the torques between two ticks of the law: writes `joint_torque` of `command` for new measurements of the
// joints \[rad, m; rad/s, m/s\], NaN where there is none; the other arrays are not touched. To be called
// `controller.torque.steps` − 1 times after each `flight_tick`, at equal times. Where the torques are kept
// `flight_is_held` says so.
//
// # Safety
// The pointers are null or point to objects of their types, positions and velocities to as many numbers as joints.
enum FlightStatus flight_tick_torques(struct FlightController *controller,
                                      const double *joint_position,
                                      const double *joint_velocity,
                                      const struct FlightCommand *command);

// Creates the simulated robot of a flight configuration, in its initial state. Allocates, as does nothing below but
// `flight_robot_free`. Arguments and failure as for `flight_controller_create`.
//
// # Safety
// As for `flight_controller_create`.
struct FlightRobot *flight_robot_create(struct FlightHeader header,
                                        const char *path,
                                        char *message,
                                        size_t message_size);

// Frees a simulated robot; null is allowed. No thread may use it then or later, nor free it again.
//
// # Safety
// `robot` comes from `flight_robot_create` and is not used afterwards.
void flight_robot_free(struct FlightRobot *robot);

// Measures a simulated robot exactly: time, pose and velocity of the base, joints, thrusts and wind, with arrays of the
// robot, which are valid until the next call for it. It has no other sensors: `foot_wrenches` and `shaft_speed` are null,
// `height` is NaN.
//
// # Safety
// `robot` comes from `flight_robot_create`, or is null; `measurement` has space for one, or is null.
enum FlightStatus flight_robot_measure(struct FlightRobot *robot,
                                       struct FlightMeasurement *measurement);

// Advances a simulated robot by one tick, in which thrust rates and joint torques of `command` act.
//
// # Safety
// `robot` comes from `flight_robot_create`, or is null; `command` is null or its arrays have the documented lengths.
enum FlightStatus flight_robot_advance(struct FlightRobot *robot,
                                       const struct FlightCommand *command);

// As `flight_robot_advance`, for torques that are computed `controller.torque.steps` times in a tick: those of `command`
// act in the first of as many equal parts, and what `torques` writes, which is called at the beginning of each other
// part with `context`; of that, numbers that no command may have act as zero. Null stands for torques that do not change.
//
// # Safety
// As for `flight_robot_advance`; `torques` is null or a function that keeps to the lengths of its arrays and does not
// use `robot`.
enum FlightStatus flight_robot_advance_in_steps(struct FlightRobot *robot,
                                                const struct FlightCommand *command,
                                                FlightTorques torques,
                                                void *context);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

// Version and sizes of this header, for flight_controller_create and flight_robot_create.
static inline FlightHeader flight_header(void) {
  FlightHeader header;
  header.version = FLIGHT_VERSION;
  header.measurement_size = sizeof(FlightMeasurement);
  header.setpoint_size = sizeof(FlightSetpoint);
  header.preview_size = sizeof(FlightPreview);
  header.command_size = sizeof(FlightCommand);
  return header;
}
