"""One flight with parts of the aerodynamic feedback left out, in a side wind of 10 m/s."""

from jax_aero import rust

changes = {
    "all": {},
    "without the torques' part": {"controller.aero_feedback.torque": False},
    "half of every force": {"disturbances.aero_estimate.scale": 0.5},
    "without the momentum's part": {"controller.aero_feedback.momentum_rate": "none"},
}
flights = rust.fly_batch([rust.load_config("test2", change) for change in changes.values()])
for name, flight in zip(changes, flights, strict=True):
    print(f"{name:27} {flight.outcome}, {100 * flight.summary['max_com_error']:.1f} cm from the mission")
