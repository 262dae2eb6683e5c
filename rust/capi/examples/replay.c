// A recorded flight through the tick of a controller, open loop: its commands act on nothing. docs/logs.md says how to compile it.
//
// replay CONFIGURATION LOG.csv     the log as `jax-aero export --csv` writes it: a row is a tick, an empty cell is missing
//
// Prints the greatest differences of the commands from those of the log: zero for a log that was flown with this configuration.
#define _GNU_SOURCE
#include "flight.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// Splits a line in place; returns the number of its cells, of which `cells` receives the first `most`.
static size_t split(char *line, char **cells, size_t most) {
    size_t count = 0;
    line[strcspn(line, "\r\n")] = 0;
    for (char *rest = line, *cell; (cell = strsep(&rest, ",")) != NULL; ++count) {
        if (count < most) {
            cells[count] = cell;
        }
    }
    return count;
}

// Whether a cell is a number, and which; an empty cell is NaN.
static int parse(const char *cell, double *number) {
    char *end;
    *number = *cell == 0 ? NAN : strtod(cell, &end);
    return *cell == 0 || (end != cell && end[strspn(end, " ")] == 0);
}

// First of the columns `NAME` or `NAME/…`, of which there are `width` in a row; exits if there are not.
static size_t find(const char *name, size_t width, char **names, size_t columns) {
    const size_t length = strlen(name);
    for (size_t first = 0; first < columns; ++first) {
        size_t count = 0;
        while (first + count < columns && strncmp(names[first + count], name, length) == 0 &&
               strchr("/", names[first + count][length]) != NULL) {
            ++count;
        }
        if (count == width) {
            return first;
        }
        if (count > 0) {
            break;
        }
    }
    fprintf(stderr, "error: the log's first line has not %zu columns `%s`, as this robot has, separated by commas\n", width, name);
    exit(1);
}

typedef struct Difference {
    double greatest, time;
} Difference;

static void compare(Difference *to, const double *ours, const double *theirs, size_t count, double time) {
    for (size_t i = 0; i < count; ++i) {
        const double difference = fabs(ours[i] - theirs[i]);
        if (!(difference <= to->greatest)) {
            *to = (Difference){difference, time};
        }
    }
}

int main(int argc, char **argv) {
    if (argc != 3) {
        fprintf(stderr, "usage: %s CONFIGURATION LOG.csv\n", argv[0]);
        return 2;
    }
    char message[1024] = "";
    FlightController *controller = flight_controller_create(flight_header(), argv[1], message, sizeof message);
    if (controller == NULL) {
        fprintf(stderr, "error: %s: %s\n", argv[1], message);
        return 1;
    }
    FILE *log = fopen(argv[2], "r");
    char *line = NULL;
    size_t space = 0;
    if (log == NULL || getline(&line, &space, log) < 0) {
        fprintf(stderr, "error: %s %s\n", argv[2], log == NULL ? "cannot be read" : "is empty; expected a log as CSV");
        return 1;
    }
    char *header = strdup(line);
    const size_t columns = split(line, NULL, 0);
    char **names = calloc(columns, sizeof *names), **cells = calloc(columns, sizeof *cells);
    double *row = calloc(columns, sizeof *row);
    const size_t joints = flight_joint_count(controller), jets = flight_jet_count(controller);
    double *numbers = calloc(2 * joints + jets + 1, sizeof *numbers);
    if (header == NULL || names == NULL || cells == NULL || row == NULL || numbers == NULL) {
        return 1;
    }
    split(header, names, columns);
    const FlightCommand command = {
        .joint_velocity = numbers, .joint_torque = numbers + joints, .thrust_rate = numbers + 2 * joints};
#define COLUMN(name, width) (row + find(name, width, names, columns))
    const double *time = COLUMN("time", 1), *position = COLUMN("raw_base_position", 3);
    const double *rotation = COLUMN("raw_base_rotation", 9), *velocity = COLUMN("raw_base_velocity", 6);
    const double *wind = COLUMN("raw_wind", 3), *torque = COLUMN("joint_torque", joints);
    const double *rate = COLUMN("thrust_rate", jets);
    FlightMeasurement measurement = {.joint_position = COLUMN("raw_joint_position", joints),
                                     .joint_velocity = COLUMN("raw_joint_velocity", joints),
                                     .thrust = COLUMN("raw_thrust", jets)};
    Difference torques = {0}, rates = {0};
    long ticks = 0, not_nominal = 0;
    for (; getline(&line, &space, log) > 0; ++ticks) {
        const size_t count = split(line, cells, columns);
        if (count != columns) {
            fprintf(stderr, "error: %s: row %ld has %zu cells; expected %zu\n", argv[2], ticks + 1, count, columns);
            return 1;
        }
        for (size_t column = 0; column < columns; ++column) {
            if (!parse(cells[column], &row[column])) {
                const char *name = names[column], *cell = cells[column];
                fprintf(stderr, "error: %s: row %ld, column `%s` is `%s`; expected a number\n", argv[2], ticks + 1, name, cell);
                return 1;
            }
        }
        measurement.time = *time;
        memcpy(measurement.base_position, position, sizeof measurement.base_position);
        memcpy(measurement.base_rotation, rotation, sizeof measurement.base_rotation);
        memcpy(measurement.base_linear_velocity, velocity, sizeof measurement.base_linear_velocity);
        memcpy(measurement.base_angular_velocity, velocity + 3, sizeof measurement.base_angular_velocity);
        memcpy(measurement.wind, wind, sizeof measurement.wind);
        if (ticks == 0 && flight_start(controller, &measurement, message, sizeof message) != FLIGHT_OK) {
            fprintf(stderr, "error: %s\n", message);
            return 1;
        }
        not_nominal +=
            flight_tick(controller, &measurement, NULL, &command) != FLIGHT_OK || flight_modes(controller) != 0;
        compare(&torques, command.joint_torque, torque, joints, *time);
        compare(&rates, command.thrust_rate, rate, jets, *time);
    }
    if (ticks == 0) {
        fprintf(stderr, "error: %s has no row below its header\n", argv[2]);
        return 1;
    }
    printf("%ld ticks, %ld not nominal\n", ticks, not_nominal);
    printf("joint_torque  greatest difference %g N m, at %g s\n", torques.greatest, torques.time);
    printf("thrust_rate   greatest difference %g N/s, at %g s\n", rates.greatest, rates.time);
    free(numbers);
    free(row);
    free(cells);
    free(names);
    free(header);
    free(line);
    fclose(log);
    flight_controller_free(controller);
    return 0;
}
