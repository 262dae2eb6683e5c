//! Shape-preserving cubic interpolation of a measured table.

use crate::error::BuildError;

/// One point of the table and the slope of the interpolant there.
#[derive(Debug, Clone, Copy)]
struct Knot {
    x: f64,
    y: f64,
    slope: f64,
}

/// Piecewise cubic Hermite interpolant (PCHIP): monotone where the table is monotone, constant outside it.
///
/// Interior slopes are the weighted harmonic mean of the neighbouring secants, or zero where these change
/// sign. Slopes at the ends are the three-point formula, limited to prevent overshoot.
///
/// Source: Fritsch and Butland, SIAM J. Sci. Stat. Comput. 5 (1984), the method of MATLAB's and scipy's
/// `pchip`. These extrapolate the end cubics outside the table; here the end values are held.
#[derive(Debug, Clone)]
pub struct Pchip {
    knots: Vec<Knot>,
}

impl Pchip {
    /// Checks the table and computes the slopes; `x_item` and `y_item` name its columns in errors.
    ///
    /// # Errors
    /// Fewer than two points, columns of different length, a value that is not finite, abscissae that do not
    /// increase strictly.
    pub fn new(x_item: &str, x: &[f64], y_item: &str, y: &[f64]) -> Result<Self, BuildError> {
        if x.len() < 2 {
            let count = format!("{} points long", x.len());
            return Err(BuildError::bad_value(format!("table `{x_item}`"), count, "at least 2 points"));
        }
        if x.len() != y.len() {
            return Err(BuildError::bad_value(
                format!("table `{y_item}`"),
                format!("{} points long", y.len()),
                format!("{} points, as many as `{x_item}`", x.len()),
            ));
        }
        for (item, values) in [(x_item, x), (y_item, y)] {
            if let Some((index, value)) = values.iter().enumerate().find(|(_, value)| !value.is_finite()) {
                return Err(BuildError::bad_value(format!("{item}[{index}]"), value, "a finite number"));
            }
        }
        if let Some((index, pair)) = x.windows(2).enumerate().find(|(_, pair)| pair[1] <= pair[0]) {
            return Err(BuildError::bad_value(
                format!("{x_item}[{}]", index + 1),
                pair[1],
                format!("more than {}, the value before it", pair[0]),
            ));
        }
        let slopes = slopes(x, y);
        let knots = x.iter().zip(y).zip(slopes).map(|((&x, &y), slope)| Knot { x, y, slope }).collect();
        Ok(Self { knots })
    }

    /// Interpolated value at `x`; outside the table, the value of the nearer end. NaN for NaN.
    #[must_use]
    pub fn at(&self, x: f64) -> f64 {
        self.interpolate(x, hermite)
    }

    /// Linear interpolation at `x`; constant outside the table.
    #[must_use]
    pub fn linear_at(&self, x: f64) -> f64 {
        self.interpolate(x, |a, b, x| a.y + (b.y - a.y) * (x - a.x) / (b.x - a.x))
    }

    /// Evaluates `curve` on the two points around `x`; outside the table, the value of the nearer end.
    fn interpolate(&self, x: f64, curve: impl Fn(&Knot, &Knot, f64) -> f64) -> f64 {
        if x.is_nan() {
            return x;
        }
        let above = self.knots.partition_point(|knot| knot.x <= x);
        match (above.checked_sub(1).and_then(|below| self.knots.get(below)), self.knots.get(above)) {
            (Some(a), Some(b)) => curve(a, b, x),
            (Some(end), None) | (None, Some(end)) => end.y,
            (None, None) => f64::NAN,
        }
    }

    /// Range of the abscissae.
    #[must_use]
    pub fn domain(&self) -> (f64, f64) {
        let x = |knot: Option<&Knot>| knot.map_or(f64::NAN, |knot| knot.x);
        (x(self.knots.first()), x(self.knots.last()))
    }

    /// Greatest value of the table.
    #[must_use]
    pub fn max(&self) -> f64 {
        self.knots.iter().map(|knot| knot.y).fold(f64::NEG_INFINITY, f64::max)
    }
}

/// Cubic with the values and slopes of both knots.
fn hermite(a: &Knot, b: &Knot, x: f64) -> f64 {
    let h = b.x - a.x;
    let s = x - a.x;
    let secant = (b.y - a.y) / h;
    let c2 = (3.0 * secant - 2.0 * a.slope - b.slope) / h;
    let c3 = (a.slope + b.slope - 2.0 * secant) / (h * h);
    a.y + s * (a.slope + s * (c2 + s * c3))
}

/// Slopes at the points of a table of two points or more.
fn slopes(x: &[f64], y: &[f64]) -> Vec<f64> {
    let h: Vec<f64> = x.windows(2).map(|x| x[1] - x[0]).collect();
    let secant: Vec<f64> = h.iter().zip(y.windows(2)).map(|(h, y)| (y[1] - y[0]) / h).collect();
    let n = secant.len();
    if n == 1 {
        return vec![secant[0]; 2];
    }
    let inner = (1..n).map(|i| inner_slope(h[i - 1], h[i], secant[i - 1], secant[i]));
    std::iter::once(end_slope(h[0], h[1], secant[0], secant[1]))
        .chain(inner)
        .chain([end_slope(h[n - 1], h[n - 2], secant[n - 1], secant[n - 2])])
        .collect()
}

/// Weighted harmonic mean of two secants; zero at an extremum.
fn inner_slope(h_left: f64, h_right: f64, left: f64, right: f64) -> f64 {
    if left * right <= 0.0 {
        return 0.0;
    }
    let w_left = 2.0 * h_right + h_left;
    let w_right = h_right + 2.0 * h_left;
    (w_left + w_right) / (w_left / left + w_right / right)
}

/// Three-point slope at an end, limited to the sign of the nearest secant and to three times its magnitude.
fn end_slope(h_near: f64, h_next: f64, near: f64, next: f64) -> f64 {
    let slope = ((2.0 * h_near + h_next) * near - h_near * next) / (h_near + h_next);
    if slope * near <= 0.0 {
        0.0
    } else if near * next < 0.0 && slope.abs() > 3.0 * near.abs() {
        3.0 * near
    } else {
        slope
    }
}
