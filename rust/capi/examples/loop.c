// The controller in a periodic loop with a deadline, as a robot's computer runs it. docs/embedding.md says how to compile it.
//
// Ticks as often as the configuration's time step says, and reports how long a tick takes and how many did not
// end in time. Memory is locked and the thread scheduled by SCHED_FIFO where the system allows it. The robot is the
// simulated one.
#define _GNU_SOURCE
#include "clock.h"
#include "flight.h"
#include <sched.h>
#include <sys/mman.h>

int main(int argc, char **argv) {
    if (argc < 2) {
        fprintf(stderr, "usage: %s CONFIGURATION [TICKS]\n", argv[0]);
        return 2;
    }
    const long ticks = argc > 2 ? atol(argv[2]) : 1000;
    char message[1024] = "";
    FlightController *controller = flight_controller_create(flight_header(), argv[1], message, sizeof message);
    FlightRobot *robot =
        controller == NULL ? NULL : flight_robot_create(flight_header(), argv[1], message, sizeof message);
    if (robot == NULL || ticks < 1) {
        fprintf(stderr, "error: %s\n", robot == NULL ? message : "TICKS is less than one");
        flight_robot_free(robot);
        flight_controller_free(controller);
        return 1;
    }
    const size_t joints = flight_joint_count(controller), jets = flight_jet_count(controller);
    const double time_step = flight_time_step(controller);
    double *numbers = calloc(2 * joints + jets + 1, sizeof *numbers);
    int64_t *durations = calloc((size_t)ticks, sizeof *durations);
    if (numbers == NULL || durations == NULL) {
        return 1;
    }
    const FlightCommand command = {
        .joint_velocity = numbers, .joint_torque = numbers + joints, .thrust_rate = numbers + 2 * joints};

    // --8<-- [start:memory]
    const int locked = mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
    const struct sched_param priority = {.sched_priority = 80};
    const int fifo = sched_setscheduler(0, SCHED_FIFO, &priority) == 0;
    // --8<-- [end:memory]

    FlightMeasurement measurement;
    flight_robot_measure(robot, &measurement);
    // Allocates; the loop does not.
    FlightStatus status = flight_start(controller, &measurement, message, sizeof message);
    if (status != FLIGHT_OK) {
        fprintf(stderr, "error: %s (%s)\n", message, flight_status_name(status));
        return 1;
    }
    // --8<-- [start:loop]
    const int64_t period = (int64_t)(time_step * 1e9);
    long late = 0, not_nominal = 0;
    uint32_t modes = 0;
    int64_t next = now_ns();
    for (long tick = 0; tick < ticks; ++tick) {
        sleep_until_ns(next);
        next += period;
        flight_robot_measure(robot, &measurement); // a robot reads its sensors here
        const int64_t begin = now_ns();
        status = flight_tick(controller, &measurement, NULL, &command);
        const int64_t end = now_ns();
        flight_robot_advance(robot, &command); // a robot sends joint_torque and thrust_rate here
        not_nominal += status != FLIGHT_OK || flight_modes(controller) != 0;
        modes |= flight_modes(controller);
        durations[tick] = end - begin;
        late += end > next;
    }
    // --8<-- [end:loop]

    qsort(durations, (size_t)ticks, sizeof *durations, by_size);
    printf("robot            %zu joints (first: %s), %zu jets\n", joints,
           joints > 0 ? flight_joint_name(controller, 0) : "-", jets);
    printf("loop             %.0f Hz, SCHED_FIFO %s, memory %s\n", 1 / time_step, fifo ? "yes" : "no",
           locked ? "locked" : "not locked");
    printf("tick [us]        p50 %.1f  p99.9 %.1f  worst %.1f\n", (double)durations[ticks / 2] / 1e3,
           (double)durations[ticks - 1 - ticks / 1000] / 1e3, (double)durations[ticks - 1] / 1e3);
    printf("late             %ld of %ld\n", late, ticks);
    printf("not nominal      %ld of %ld", not_nominal, ticks);
    for (uint32_t mode = 1; mode != 0; mode <<= 1) {
        if (modes & mode) {
            printf(" %s", flight_mode_name(mode));
        }
    }
    const double *at = measurement.base_position;
    printf("\nlast tick        %.2f s: base at %.3f, %.3f, %.3f m, wind %.1f m/s along y\n", measurement.time, at[0],
           at[1], at[2], measurement.wind[1]);
    free(durations);
    free(numbers);
    flight_robot_free(robot);
    flight_controller_free(controller);
    return 0;
}
