// The controller in one process, the simulated robot in another: UDP on loopback, paced by the clock. Then the same flight in one
// process. docs/embedding.md says how to compile it, and what was measured.
//
// The robot sends a measurement at each tick, and its joints at each tick of the torques (controller.torque.steps), and waits
// for the answer until the next one is due; what has not arrived by then is lost, and the last command acts.
#define _GNU_SOURCE
#include "clock.h"
#include "flight.h"
#include <netinet/in.h>
#include <poll.h>
#include <sched.h>
#include <stddef.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

enum { MOST = 512 };                     // numbers in a message
static const int64_t PATIENCE = 5000000000; // ns, for the first answer, and without pace

static size_t joints, jets;

// A question of the robot or an answer of the controller.
typedef struct Message {
    int64_t tick; // -1 ends the flight
    int64_t part; // 0: a tick of the law; others: of the torques
    double numbers[MOST];
} Message;

// One side of a flight.
typedef struct Link {
    int socket; // to the other process; -1 if the controller is in this one
    FlightController *controller;
    int64_t period, next; // ns; a period of zero is no pace
    Message question, answer;
    uint64_t digest; // of every question and every command that acts (FNV-1a)
    long asked, lost;
    int64_t *late, *trip; // ns
} Link;

static double *put(double *to, const double *from, size_t count) {
    memcpy(to, from, count * sizeof *to);
    return to + count;
}

static size_t pack(const FlightMeasurement *m, double *numbers) {
    double *end = put(numbers, &m->time, 1);
    end = put(end, m->base_position, 3);
    end = put(end, m->base_rotation, 9);
    end = put(end, m->base_linear_velocity, 3);
    end = put(end, m->base_angular_velocity, 3);
    end = put(end, m->wind, 3);
    end = put(end, m->joint_position, joints);
    end = put(end, m->joint_velocity, joints);
    return (size_t)(put(end, m->thrust, jets) - numbers);
}

// A measurement whose arrays are those of the message.
static FlightMeasurement unpack(const double *numbers) {
    FlightMeasurement m = {.time = numbers[0]};
    memcpy(m.base_position, numbers + 1, sizeof m.base_position);
    memcpy(m.base_rotation, numbers + 4, sizeof m.base_rotation);
    memcpy(m.base_linear_velocity, numbers + 13, sizeof m.base_linear_velocity);
    memcpy(m.base_angular_velocity, numbers + 16, sizeof m.base_angular_velocity);
    memcpy(m.wind, numbers + 19, sizeof m.wind);
    m.joint_position = numbers + 22;
    m.joint_velocity = m.joint_position + joints;
    m.thrust = m.joint_velocity + joints;
    return m;
}

// An answer holds torques and thrust rates, then joint velocities.
static FlightCommand command_in(Message *answer) {
    double *numbers = answer->numbers;
    return (FlightCommand){.joint_torque = numbers,
                           .thrust_rate = numbers + joints,
                           .joint_velocity = numbers + joints + jets};
}

// --8<-- [start:answer]
static FlightStatus answer(FlightController *controller, const Message *question, Message *reply) {
    const FlightCommand command = command_in(reply);
    reply->tick = question->tick;
    reply->part = question->part;
    if (question->part > 0) {
        return flight_tick_torques(controller, question->numbers, question->numbers + joints, &command);
    }
    const FlightMeasurement measurement = unpack(question->numbers);
    if (question->tick == 0) {
        const FlightStatus status = flight_start(controller, &measurement, NULL, 0);
        if (status != FLIGHT_OK) {
            return status;
        }
    }
    return flight_tick(controller, &measurement, NULL, &command);
}
// --8<-- [end:answer]

static void print_times(const char *name, int64_t *times, long count) {
    qsort(times, (size_t)count, sizeof *times, by_size);
    printf("%-17sp50 %.1f  p99 %.1f  worst %.1f\n", name, (double)times[count / 2] / 1e3,
           (double)times[count - 1 - count / 100] / 1e3, (double)times[count - 1] / 1e3);
}

static void take_priority(int *locked, int *fifo) {
    *locked = mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
    const struct sched_param priority = {.sched_priority = 80};
    *fifo = sched_setscheduler(0, SCHED_FIFO, &priority) == 0;
}

// The controller's process: answers until the flight ends.
static int serve(int socket, FlightController *controller, long most) {
    int locked, fifo;
    take_priority(&locked, &fifo);
    static Message question, reply;
    int64_t *durations = calloc((size_t)most, sizeof *durations);
    long ticks = 0, not_nominal = 0;
    struct sockaddr_in from;
    socklen_t length = sizeof from;
    while (durations != NULL &&
           recvfrom(socket, &question, sizeof question, 0, (struct sockaddr *)&from, &length) > 0 && question.tick >= 0) {
        const int64_t begin = now_ns();
        not_nominal += answer(controller, &question, &reply) != FLIGHT_OK || flight_modes(controller) != 0;
        durations[ticks++ % most] = now_ns() - begin;
        const size_t size = offsetof(Message, numbers) + (joints + jets) * sizeof(double);
        sendto(socket, &reply, size, 0, (struct sockaddr *)&from, length);
    }
    if (ticks > 0) {
        print_times("tick [us]", durations, ticks < most ? ticks : most);
    }
    printf("not nominal      %ld of %ld\n", not_nominal, ticks);
    free(durations);
    return 0;
}

// Waits until a time for the answer to this question; older ones are dropped.
static int receive(int socket, const Message *question, Message *reply, int64_t until) {
    static Message arrived;
    for (int64_t left; (left = until - now_ns()) > 0;) {
        struct pollfd waiting = {.fd = socket, .events = POLLIN};
        const struct timespec patience = {.tv_sec = left / 1000000000, .tv_nsec = left % 1000000000};
        if (ppoll(&waiting, 1, &patience, NULL) > 0 && recv(socket, &arrived, sizeof arrived, 0) > 0 &&
            arrived.tick == question->tick && arrived.part == question->part) {
            memcpy(reply, &arrived, offsetof(Message, numbers) + (joints + jets) * sizeof(double));
            return 1;
        }
    }
    return 0;
}

static void add_to_digest(uint64_t *digest, const double *numbers, size_t count) {
    const unsigned char *bytes = (const unsigned char *)numbers;
    for (size_t i = 0; i < count * sizeof *numbers; ++i) {
        *digest = (*digest ^ bytes[i]) * 0x100000001b3;
    }
}

// Sends a question of so many numbers when it is due, and takes the answer over.
static void ask(Link *link, size_t count) {
    const Message *question = &link->question;
    const int is_first = link->asked == 0;
    if (link->period > 0 && !is_first) {
        sleep_until_ns(link->next);
    }
    const int64_t begin = now_ns();
    if (link->socket < 0) {
        answer(link->controller, question, &link->answer);
    } else {
        const int64_t until = link->period > 0 && !is_first ? link->next + link->period : begin + PATIENCE;
        send(link->socket, question, offsetof(Message, numbers) + count * sizeof(double), 0);
        link->lost += !receive(link->socket, question, &link->answer, until);
    }
    link->trip[link->asked] = now_ns() - begin;
    link->late[link->asked] = link->period > 0 && !is_first ? begin - link->next : 0;
    link->next = is_first ? now_ns() + link->period : link->next + link->period;
    ++link->asked;
    add_to_digest(&link->digest, question->numbers, count);
    add_to_digest(&link->digest, link->answer.numbers, joints + jets);
}

static void ask_torques(uint32_t part, const double *position, const double *velocity, double *torque, void *context) {
    Link *link = context;
    link->question.part = part;
    put(put(link->question.numbers, position, joints), velocity, joints);
    ask(link, 2 * joints);
    memcpy(torque, link->answer.numbers, joints * sizeof *torque);
}

static void fly(Link *link, FlightRobot *robot, long ticks) {
    const FlightCommand command = command_in(&link->answer);
    for (long tick = 0; tick < ticks; ++tick) {
        FlightMeasurement measurement;
        flight_robot_measure(robot, &measurement);
        link->question.tick = tick;
        link->question.part = 0;
        ask(link, pack(&measurement, link->question.numbers));
        flight_robot_advance_in_steps(robot, &command, ask_torques, link);
    }
}

// Two ends of a UDP channel on loopback, the first of which answers to whom has asked.
static int open_channel(int ends[2]) {
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    socklen_t length = sizeof address;
    ends[0] = socket(AF_INET, SOCK_DGRAM, 0);
    ends[1] = socket(AF_INET, SOCK_DGRAM, 0);
    return ends[0] >= 0 && ends[1] >= 0 && bind(ends[0], (struct sockaddr *)&address, length) == 0 &&
           getsockname(ends[0], (struct sockaddr *)&address, &length) == 0 &&
           connect(ends[1], (struct sockaddr *)&address, length) == 0;
}

int main(int argc, char **argv) {
    const long ticks = argc > 2 ? atol(argv[2]) : 1000;
    const double speed = argc > 3 ? atof(argv[3]) : 1.0;
    if (argc < 2 || ticks < 1 || speed < 0.0) {
        fprintf(stderr, "usage: %s CONFIGURATION [TICKS [SPEED]]; SPEED 0: without pace\n", argv[0]);
        return 2;
    }
    char message[1024] = "";
    FlightController *controller = flight_controller_create(flight_header(), argv[1], message, sizeof message);
    FlightRobot *robots[2] = {NULL, NULL};
    for (int i = 0; i < 2 && controller != NULL; ++i) {
        robots[i] = flight_robot_create(flight_header(), argv[1], message, sizeof message);
    }
    if (robots[1] == NULL) {
        fprintf(stderr, "error: %s\n", message);
        return 1;
    }
    joints = flight_joint_count(controller);
    jets = flight_jet_count(controller);
    const uint32_t parts = flight_torque_steps(controller);
    const double period = flight_time_step(controller) / parts;
    const long most = ticks * (long)parts;
    static Link links[2];
    int ends[2] = {-1, -1};
    if (22 + 2 * joints + jets > MOST || !open_channel(ends)) {
        fprintf(stderr, "error: %s\n", ends[0] < 0 ? "too many joints" : "no UDP on loopback");
        return 1;
    }
    const pid_t child = fork();
    if (child == 0) {
        const int status = serve(ends[0], controller, most);
        flight_robot_free(robots[0]);
        flight_robot_free(robots[1]);
        flight_controller_free(controller);
        return status;
    }
    int locked, fifo;
    take_priority(&locked, &fifo);
    for (int i = 0; i < 2 && child > 0; ++i) {
        links[i] = (Link){.socket = i == 0 ? ends[1] : -1, .controller = controller, .digest = 0xcbf29ce484222325};
        links[i].period = i == 0 && speed > 0.0 ? (int64_t)(period / speed * 1e9) : 0;
        links[i].late = calloc((size_t)most, sizeof *links[i].late);
        links[i].trip = calloc((size_t)most, sizeof *links[i].trip);
        if (links[i].late == NULL || links[i].trip == NULL) {
            return 1;
        }
        if (i == 0) {
            printf("channel          UDP, %.0f Hz, SCHED_FIFO %s, memory %s\n", 1 / period, fifo ? "yes" : "no",
                   locked ? "locked" : "not locked");
            fflush(stdout);
        }
        fly(&links[i], robots[i], ticks);
        if (i == 0) {
            const Message end = {.tick = -1};
            send(ends[1], &end, offsetof(Message, numbers), 0);
            waitpid(child, NULL, 0);
        }
        flight_robot_free(robots[i]);
    }
    print_times("late [us]", links[0].late, most);
    print_times("round trip [us]", links[0].trip, most);
    printf("lost             %ld of %ld\n", links[0].lost, most);
    const int is_same = links[0].digest == links[1].digest;
    printf("in one process   %s\n", is_same ? "the same flight, bit by bit" : "another flight");
    flight_controller_free(controller);
    return is_same || links[0].lost > 0 ? 0 : 1;
}
