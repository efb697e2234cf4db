//! The kernel's mounting matrix of a sensor, from the board's description.

use nalgebra::Matrix3;

/// Boards give the numbers with few digits, such as 0.7071.
const TOLERANCE: f64 = 0.01;

/// Reads a matrix such as `1, 0, 0; 0, 1, 0; 0, 0, 1`. `None` for a text that is not a rotation.
pub(super) fn parse(text: &str) -> Option<Matrix3<f64>> {
    let mut matrix = Matrix3::<f64>::zeros();
    let mut rows = text.split(';');
    for row in 0..3 {
        let mut numbers = rows.next()?.split(',');
        for column in 0..3 {
            matrix[(row, column)] = numbers.next()?.trim().parse().ok()?;
        }
        if numbers.next().is_some() {
            return None;
        }
    }
    let is_rotation = (matrix * matrix.transpose() - Matrix3::identity()).amax() <= TOLERANCE
        && matrix.determinant() > 0.0;
    (is_rotation && rows.next().is_none()).then_some(matrix)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_separated_by_semicolons() {
        assert_eq!(parse("1, 0, 0; 0, 1, 0; 0, 0, 1"), Some(Matrix3::identity()));
        let rotated = parse("0.8, -0.6, 0; 0.6, 0.8, 0; 0, 0, 1").unwrap();
        assert_eq!((rotated[(0, 1)], rotated[(1, 0)]), (-0.6, 0.6));
    }

    #[test]
    fn a_text_that_is_no_rotation_is_refused() {
        for text in [
            "",
            "(null), (null), (null); (null), (null), (null); (null), (null), (null)",
            "1, 0, 0; 0, 1, 0",
            "1, 0, 0; 0, 1, 0; 0, 0, 1; 0, 0, 1",
            "1, 0, 0, 0; 0, 1, 0; 0, 0, 1",
            "0, 0, 0; 0, 0, 0; 0, 0, 0",
            "2, 0, 0; 0, 1, 0; 0, 0, 1",
            "nan, 0, 0; 0, 1, 0; 0, 0, 1",
            // A mirror would change the sense of rotation.
            "1, 0, 0; 0, 1, 0; 0, 0, -1",
        ] {
            assert_eq!(parse(text), None, "{text}");
        }
    }
}
