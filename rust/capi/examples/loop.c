// The controller in a periodic loop with a deadline, as a robot's computer runs it. docs/howto/embedding.md says how to compile it.
//
// Ticks as often as the configuration's time step says, and reports how long a tick takes and how many did not
// end in time. Memory is locked and the thread scheduled by SCHED_FIFO where the system allows it.
#define _GNU_SOURCE
#include "flight.h"
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>

static int64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static void sleep_until_ns(int64_t time) {
    struct timespec t = {.tv_sec = time / 1000000000, .tv_nsec = time % 1000000000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) != 0) {
    }
}

static int by_size(const void *left, const void *right) {
    const int64_t a = *(const int64_t *)left, b = *(const int64_t *)right;
    return (a > b) - (a < b);
}

int main(int argc, char **argv) {
    if (argc < 2) {
        fprintf(stderr, "usage: %s CONFIGURATION [TICKS]\n", argv[0]);
        return 2;
    }
    const long ticks = argc > 2 ? atol(argv[2]) : 1000;
    char message[1024] = "";
    FlightController *controller = flight_controller_create(argv[1], message, sizeof message);
    if (controller == NULL || ticks < 1) {
        fprintf(stderr, "error: %s\n", controller == NULL ? message : "TICKS is less than one");
        flight_controller_free(controller);
        return 1;
    }
    const size_t joints = flight_joint_count(controller), jets = flight_jet_count(controller);
    const double time_step = flight_time_step(controller);
    double *numbers = calloc(4 * joints + 2 * jets + 1, sizeof *numbers);
    int64_t *durations = calloc((size_t)ticks, sizeof *durations);
    if (numbers == NULL || durations == NULL) {
        return 1;
    }
    double *joint_position = numbers, *joint_velocity = joint_position + joints;
    double *velocity_command = joint_velocity + joints, *torque = velocity_command + joints;
    double *thrust = torque + joints, *thrust_rate = thrust + jets;
    FlightMeasurement measurement = {
        .base_rotation = {1, 0, 0, 0, 1, 0, 0, 0, 1},
        .joint_position = joint_position,
        .joint_velocity = joint_velocity,
        .thrust = thrust,
    };
    const FlightCommand command = {thrust_rate, velocity_command, torque};
    for (size_t jet = 0; jet < jets; ++jet) {
        thrust[jet] = 100.0;
    }

    // --8<-- [start:memory]
    const int locked = mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
    const struct sched_param priority = {.sched_priority = 80};
    const int fifo = sched_setscheduler(0, SCHED_FIFO, &priority) == 0;
    // --8<-- [end:memory]

    // Allocates; the loop does not.
    FlightStatus status = flight_start(controller, &measurement);
    if (status != FLIGHT_NOMINAL) {
        fprintf(stderr, "error: the flight did not start (status %d)\n", (int)status);
        return 1;
    }
    // --8<-- [start:loop]
    const int64_t period = (int64_t)(time_step * 1e9);
    long late = 0, not_nominal = 0;
    int64_t next = now_ns();
    for (long tick = 0; tick < ticks; ++tick) {
        sleep_until_ns(next);
        next += period;
        const int64_t begin = now_ns();
        // A robot reads its sensors here. This one stays where it is: the command goes nowhere.
        measurement.time = (double)tick * time_step;
        status = flight_tick(controller, &measurement, NULL, &command);
        not_nominal += status != FLIGHT_NOMINAL;
        // A robot sends torque and thrust_rate here.
        const int64_t end = now_ns();
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
    printf("not nominal      %ld of %ld\n", not_nominal, ticks);
    printf("thrust rate      ");
    for (size_t jet = 0; jet < jets; ++jet) {
        printf(" %.17g", thrust_rate[jet]);
    }
    printf("\n");
    free(durations);
    free(numbers);
    flight_controller_free(controller);
    return 0;
}
