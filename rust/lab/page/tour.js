// Five scenes: what is flown, two sentences, and the number that proves them, which the page computes from whole flights.
import { DEFAULTS } from "./scenario.js";

const degrees = (radians) => `${((radians * 180) / Math.PI).toFixed(1)}°`;
const hover = { ...DEFAULTS, mission: "hover" };

/** `settings` are shown from `start` [s]; `others` are flown with them; `ghost` is another controller's; `proof` reads all results. */
export const TOUR = [
  {
    name: "Hover",
    settings: { ...hover, controller: "aware", speed: 0 },
    others: {},
    ghost: "none",
    start: 0,
    text: "Four jets carry the robot, and the controller corrects thrusts and joints 100 times a second so that it stays in place. The air is still: nothing pushes it away.",
    proof: ({ shown }) => [`${(1000 * shown.summary.max_com_error).toFixed(1)} mm`, "from its set-point at most, the centre of mass, after a start-up of 3\u00a0s"],
  },
  {
    name: "The wind rises",
    settings: { ...hover, controller: "aware" },
    others: {},
    ghost: "none",
    start: 4,
    text: "Between 5 and 10 s a side wind rises to 10 m/s and pushes on every link. This controller is given the wind and has a model of these forces, so its jets answer before the robot is pushed away.",
    proof: ({ shown }) => [`${shown.summary.max_aero_force.toFixed(1)} N`, `of air, held with a rotation error of at most ${degrees(shown.summary.max_rotation_error)}`],
  },
  {
    name: "The baseline leans",
    settings: { ...DEFAULTS, controller: "baseline" },
    others: { aware: { ...DEFAULTS, controller: "aware" } },
    ghost: "aware",
    start: 5,
    text: "The paper's flight without an aerodynamic model: the moment of the air turns the robot until its stiffness holds against it. The violet ghost is the aware controller in the same wind.",
    proof: ({ shown, aware }) => [
      degrees(shown.summary.max_rotation_error),
      `greatest rotation error; ${degrees(aware.summary.max_rotation_error)} with the model`,
    ],
  },
  {
    name: "The lever arm that decides",
    settings: { ...DEFAULTS, controller: "baseline", arms: "published" },
    others: { corrected: { ...DEFAULTS, controller: "baseline" } },
    ghost: "none",
    start: 8,
    text: "The published simulator adds a link's offset without turning it into inertial axes, which triples the aerodynamic moment at hover: 1.9 instead of 0.67 N m. Only with this error does the baseline fall.",
    proof: ({ shown, corrected }) => [
      shown.lost_time === null ? "completes" : `${shown.lost_time.toFixed(1)} s`,
      `until it falls; with corrected arms it ${corrected.lost_time === null ? "completes" : "falls too"}`,
    ],
  },
  {
    name: "No model needed",
    settings: { ...DEFAULTS, controller: "observer", arms: "published" },
    others: { baseline: { ...DEFAULTS, controller: "baseline", arms: "published" } },
    ghost: "baseline",
    start: 8,
    text: "The observer compares the robot's momentum with what its thrusts should give and takes the rest for a wrench of the air. Without model and wind sensor it completes the very flight that the baseline, the ghost, loses.",
    proof: ({ shown, baseline }) => [
      degrees(shown.summary.max_rotation_error),
      `greatest rotation error; the baseline ${baseline.lost_time === null ? "completes" : `falls at ${baseline.lost_time.toFixed(1)} s`}`,
    ],
  },
];
