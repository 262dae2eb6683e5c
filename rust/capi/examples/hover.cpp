// The controller from C++, also without exceptions: a planner of one's own hands over a set-point in each tick.
#include "flight.h"
#include <array>
#include <cstdio>
#include <memory>
#include <vector>

// --8<-- [start:class]
class Controller {
  public:
    explicit Controller(const char *path) {
        handle.reset(flight_controller_create(flight_header(), path, message.data(), message.size()));
        if (handle) {
            thrust_rate.resize(flight_jet_count(handle.get()));
            joint_velocity.resize(flight_joint_count(handle.get()));
            joint_torque.resize(flight_joint_count(handle.get()));
        }
    }
    explicit operator bool() const { return handle != nullptr; }
    // Why a file or a start was refused.
    const char *refusal() const { return message.data(); }
    bool start(const FlightMeasurement &measurement) {
        return flight_start(handle.get(), &measurement, message.data(), message.size()) == FLIGHT_OK;
    }
    bool tick(const FlightMeasurement &measurement, const FlightSetpoint &setpoint) {
        const FlightCommand command{thrust_rate.data(), joint_velocity.data(), joint_torque.data()};
        return flight_tick(handle.get(), &measurement, &setpoint, &command) == FLIGHT_OK && !flight_is_held(handle.get());
    }

    std::vector<double> thrust_rate, joint_velocity, joint_torque;

  private:
    struct Free {
        void operator()(FlightController *controller) const { flight_controller_free(controller); }
    };
    std::unique_ptr<FlightController, Free> handle;
    std::array<char, 1024> message{};
};
// --8<-- [end:class]

int main(int argc, char **argv) {
    if (argc != 2) {
        std::fprintf(stderr, "usage: %s CONFIGURATION\n", argv[0]);
        return 2;
    }
    Controller controller(argv[1]);
    const std::vector<double> still(controller.joint_velocity.size());
    const std::vector<double> thrust(controller.thrust_rate.size(), 100.0);
    FlightMeasurement measurement{};
    measurement.base_rotation[0] = measurement.base_rotation[4] = measurement.base_rotation[8] = 1.0;
    measurement.joint_position = measurement.joint_velocity = still.data();
    measurement.thrust = thrust.data();
    if (!controller || !controller.start(measurement)) {
        std::fprintf(stderr, "error: %s\n", controller.refusal());
        return 1;
    }
    FlightSetpoint setpoint{};
    setpoint.rotation[0] = setpoint.rotation[4] = setpoint.rotation[8] = 1.0;
    setpoint.com_position[2] = 1.0;
    const bool is_of_law = controller.tick(measurement, setpoint);
    std::printf("%s, thrust rate", is_of_law ? "nominal" : "held");
    for (const double rate : controller.thrust_rate) {
        std::printf(" %.17g", rate);
    }
    std::printf("\n");
    return is_of_law ? 0 : 1;
}
