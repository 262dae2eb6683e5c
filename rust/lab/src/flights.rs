//! Flights by number, and the requests of a page.

use flight_core::error::BuildError;
use flight_core::kinematics::{Kinematics, RobotState};
use flight_core::spatial::{Pose, rotation_from_wxyz};
use flight_io::{Schema, from_value, resolve_table, set_keys};
use flight_sim::{Flight, Scenario, ScenarioConfig, Wind, WindConfig};
use serde::Deserialize;
use serde_json::{Map, Value, json};
use std::path::Path;

/// Folder from which paths in a page's configuration start.
const FOLDER: &str = "configs/experiments";

/// Requests of a page.
#[derive(Deserialize)]
#[serde(tag = "ask", rename_all = "snake_case", deny_unknown_fields)]
enum Question {
    /// Creates a flight from a configuration, which may use the files in memory as base files, with changes of dotted
    /// keys (`flight_io::set_keys`).
    Begin {
        config: Map<String, Value>,
        #[serde(default)]
        changes: Vec<(String, Value)>,
    },
    /// Changes the wind from the next tick on.
    Wind { flight: usize, wind: Value },
    /// Returns the outcome of a flight; before its end, as if it ended now.
    Result { flight: usize },
    /// Frees the memory of a flight.
    End { flight: usize },
}

/// A flight, with the kinematics for its poses.
struct HeldFlight {
    flight: Flight,
    state: RobotState,
    kinematics: Kinematics,
    poses: Vec<f64>,
}

/// All flights; the number of a flight is its index.
#[derive(Default)]
pub struct Flights {
    held: Vec<Option<HeldFlight>>,
}

impl Flights {
    /// Returns the answer to a request: an object, which has `refused` if the request failed.
    pub fn answer(&mut self, question: &[u8]) -> String {
        let question =
            serde_json::from_slice(question).map_err(|error| BuildError::malformed("question", error));
        let answer = question.and_then(|question| match question {
            Question::Begin { config, changes } => self.begin(config, changes),
            Question::Wind { flight, wind } => {
                let wind: WindConfig = from_value(wind, "wind")?;
                self.find(flight)?.flight.set_wind(Wind::new(&wind)?);
                Ok(json!({}))
            }
            Question::Result { flight } => Ok(self.find(flight)?.result()),
            Question::End { flight } => {
                self.find(flight)?;
                self.held[flight] = None;
                Ok(json!({}))
            }
        });
        answer.unwrap_or_else(|error| json!({ "refused": error.to_string() })).to_string()
    }

    fn find(&mut self, flight: usize) -> Result<&mut HeldFlight, BuildError> {
        let held = self.held.get_mut(flight).and_then(Option::as_mut);
        held.ok_or_else(|| BuildError::bad_value("flight", flight, "the number of one that has begun"))
    }

    fn begin(
        &mut self,
        config: Map<String, Value>,
        changes: Vec<(String, Value)>,
    ) -> Result<Value, BuildError> {
        let (folder, schema) = (Path::new(FOLDER), Schema::of_type::<ScenarioConfig>());
        let resolved = set_keys(resolve_table(config, folder, &schema)?, changes, folder, &schema)?;
        let config: ScenarioConfig = from_value(resolved, "scenario")?;
        let flight = Scenario::new(&config)?.begin();
        let robot = flight.robot();
        let free = self.held.iter().position(Option::is_none);
        let number = free.unwrap_or(self.held.len());
        let about = json!({
            "flight": number,
            "n_ticks": flight.n_ticks(),
            "config": config,
            "bodies": robot.bodies.iter().map(|body| &body.name).collect::<Vec<_>>(),
            "jets": robot.jets.iter().map(|jet| &jet.name).collect::<Vec<_>>(),
            "links": robot.aero_links.iter().map(|link| &link.name).collect::<Vec<_>>(),
            "signals": flight.log().series.iter().map(|series| json!({
                "name": series.signal.name,
                "unit": series.signal.unit,
                "dims": series.signal.dims,
                "width": series.width(),
            })).collect::<Vec<_>>(),
        });
        let held = HeldFlight {
            state: RobotState::zero(robot.joints.len()),
            kinematics: Kinematics::new(robot),
            poses: Vec::new(),
            flight,
        };
        if free.is_none() {
            self.held.push(None);
        }
        self.held[number] = Some(held);
        Ok(about)
    }

    /// Flies up to `ticks` ticks; returns the number of rows in the log.
    pub fn advance(&mut self, flight: usize, ticks: usize) -> usize {
        let Ok(HeldFlight { flight, .. }) = self.find(flight) else { return 0 };
        for _ in 0..ticks {
            if !flight.step() {
                break;
            }
        }
        flight.log().len()
    }

    /// All rows of a signal.
    pub fn series(&self, flight: usize, index: usize) -> Option<&[f64]> {
        let held = self.held.get(flight)?.as_ref()?;
        held.flight.log().series.get(index).map(|series| &series.data[..])
    }

    /// Poses of all bodies at a row of the log: rotation by columns, then position.
    pub fn pose(&mut self, flight: usize, row: usize) -> Option<&[f64]> {
        let HeldFlight { flight, state, kinematics, poses } = self.find(flight).ok()?;
        let log = flight.log();
        let read = |name: &str| log.series(name).map(|series| series.row(row)).filter(|row| !row.is_empty());
        let quaternion: [f64; 4] = read("base_quaternion")?.try_into().ok()?;
        let position: [f64; 3] = read("base_position")?.try_into().ok()?;
        state.base = Pose { rotation: rotation_from_wxyz(&quaternion), position: position.into() };
        state.joint_position.as_mut_slice().copy_from_slice(read("joint_position")?);
        kinematics.update(flight.robot(), state);
        poses.clear();
        for body in &kinematics.bodies {
            poses.extend(body.i_from_b.rotation.iter().chain(&body.i_from_b.position));
        }
        Some(poses)
    }
}

impl HeldFlight {
    fn result(&self) -> Value {
        let (summary, loss) = (self.flight.summary(), self.flight.loss());
        let figures = summary.figures(self.flight.log().has_ground());
        let figures = figures.map(|(figure, value)| (figure.name.to_owned(), value.into()));
        json!({
            "has_ended": self.flight.has_ended(),
            "outcome": self.flight.outcome(&summary).name(),
            "lost_time": loss.map(|loss| loss.time),
            "lost_reason": loss.map(|loss| loss.reason.to_string()),
            "joint_setpoint": self.flight.log().joint_setpoint,
            "summary": figures.collect::<Map<String, Value>>(),
        })
    }
}
