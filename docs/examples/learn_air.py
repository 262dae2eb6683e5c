"""What three flights teach of the air: coefficients, and what each model leaves of the observed wrench."""

from jax_aero import rust
from jax_aero.base.places import CONFIGS
from jax_aero.body.robot import load_robot
from jax_aero.train import flights, from_flights

wind = {"profile": "turbulent", "ramp_start": 0.5, "ramp_end": 2.0, "std": [3.0, 3.0, 1.5], "time_scale": 1.5}
logs = []
for seed, velocity in enumerate([[-9.0, 2.0, 0.0], [3.0, 8.0, 0.0], [2.0, -8.0, 0.0]]):
    blowing = wind | {"velocity": velocity, "seed": seed}
    config = rust.load_config("test1_observer", {"wind": blowing, "mission": {}, "simulator.duration": 20.0})
    log = rust.fly(config).log  # no aerodynamic model: the observer estimates the whole wrench
    logs.append(flights.flight_of(f"log {seed}", log, config, load_robot(config["robot"])))

few = {"network.hidden": [8], "training.epochs": 30, "held_out": 0.4}  # a minute of flight, one of them judges
settings, _ = from_flights.read_settings(CONFIGS / "training_flights/hover.toml", few)
learnt = from_flights.learn(settings, logs, load_robot(config["robot"]))
for model, (force, moment) in learnt.errors.items():
    print(f"{model:10} leaves {force:5.2f} N, {moment:5.3f} N m")
