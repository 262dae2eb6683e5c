"""The thrust sensors fail for good after two seconds: what the controller uses in their place."""

from jax_aero import rust

outage = {"channel": "thrust", "start": 2.0, "duration": 60.0, "kind": "missing"}
config = rust.load_config("test2_observer", {"simulator.duration": 6.0, "disturbances.outages": [outage]})
flight = rust.Flight(config)
while not flight.has_ended:
    flight.step()
print(flight.result().outcome, "with", flight.last.degraded_modes)
