//! The declaration of a quantity of a flight: a signal of its log or a figure of merit.
//!
//! Log, Python bindings, result files, tables, figures and reports follow these declarations.

use flight_core::robot::RobotModel;
use serde::Serialize;

/// Dimension of a signal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Dimension {
    /// Ticks.
    Time,
    /// Axes.
    Xyz,
    /// Axes of the base.
    BaseAxis,
    /// Components of a quaternion.
    Wxyz,
    /// Roll, pitch, yaw.
    Rpy,
    /// Linear axes, then angular axes.
    Six,
    /// Joints of the robot.
    Joint,
    /// Jets of the robot.
    Jet,
    /// Aerodynamic links of the robot.
    Link,
    /// Momentum QP, then torque QP.
    Qp,
    /// Feet of the robot.
    Foot,
}

impl Dimension {
    /// Length of the dimension in one row of the log of a robot.
    #[must_use]
    pub fn len(self, robot: &RobotModel) -> usize {
        match self {
            Self::Time => 1,
            Self::Qp => 2,
            Self::Xyz | Self::BaseAxis | Self::Rpy => 3,
            Self::Wxyz => 4,
            Self::Six => 6,
            Self::Joint => robot.joints.len(),
            Self::Jet => robot.jets.len(),
            Self::Link => robot.aero_links.len(),
            Self::Foot => robot.feet.len(),
        }
    }
}

/// What the numbers of a quantity are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Numbers {
    /// Real numbers.
    Real,
    /// Integers.
    Integer,
    /// Codes, each of which stands for something.
    Code,
    /// Sums of bits, each of which stands for something.
    Bits,
}

/// Numbers with the names of what they stand for.
pub type Codes = &'static [(u32, &'static str)];

/// The declaration of a quantity, which `R` reads.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Quantity<R> {
    /// Name in result files.
    pub name: &'static str,
    /// Name in plots and tables; empty for the words of `name`.
    pub label: &'static str,
    /// Dimensions; a quantity without time has one value per flight.
    pub dims: &'static [Dimension],
    /// Unit in UDUNITS notation.
    pub unit: &'static str,
    /// Unit in which it is shown; empty for the usual one.
    pub shown: &'static str,
    /// Meaning.
    pub meaning: &'static str,
    /// What its numbers are.
    pub numbers: Numbers,
    /// What codes and bits stand for.
    pub codes: Codes,
    /// Whether only engines with ground have it.
    pub is_of_ground: bool,
    /// Whether tables of flights show it.
    pub is_tabled: bool,
    /// Whether it is an error, of which a lost flight counts as having the greatest.
    pub is_error: bool,
    /// How it is read.
    #[serde(skip)]
    pub read: R,
}

impl<R: Copy> Quantity<R> {
    /// A quantity of real numbers that every engine has.
    pub(crate) const fn new(
        name: &'static str,
        dims: &'static [Dimension],
        unit: &'static str,
        meaning: &'static str,
        read: R,
    ) -> Self {
        Self {
            name,
            label: "",
            dims,
            unit,
            shown: "",
            meaning,
            numbers: Numbers::Real,
            codes: &[],
            is_of_ground: false,
            is_tabled: false,
            is_error: false,
            read,
        }
    }

    pub(crate) const fn label(self, label: &'static str) -> Self {
        Self { label, ..self }
    }

    /// The same, shown in this unit.
    pub(crate) const fn shown(self, shown: &'static str) -> Self {
        Self { shown, ..self }
    }

    pub(crate) const fn integer(self) -> Self {
        Self { numbers: Numbers::Integer, ..self }
    }

    pub(crate) const fn coded(self, codes: Codes) -> Self {
        Self { numbers: Numbers::Code, codes, ..self }
    }

    pub(crate) const fn bits(self, codes: Codes) -> Self {
        Self { numbers: Numbers::Bits, codes, ..self }
    }

    pub(crate) const fn tabled(self) -> Self {
        Self { is_tabled: true, ..self }
    }

    pub(crate) const fn error(self) -> Self {
        Self { is_error: true, ..self }
    }

    pub(crate) const fn of_ground(self) -> Self {
        Self { is_of_ground: true, ..self }
    }
}

impl<R> Quantity<R> {
    /// Shape of one row of the log of a robot.
    pub fn row_shape(&self, robot: &RobotModel) -> impl Iterator<Item = usize> {
        self.dims.iter().filter(|dim| **dim != Dimension::Time).map(|dim| dim.len(robot))
    }

    /// Numbers in one row of the log of a robot.
    #[must_use]
    pub fn row_len(&self, robot: &RobotModel) -> usize {
        self.row_shape(robot).product()
    }
}
