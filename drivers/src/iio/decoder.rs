//! From a record of the kernel to a sample.

use hal::ImuSample;
use nalgebra::{Matrix3, Vector3};

use super::{Layout, Place};

/// One axis of a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    pub place: Place,
    /// Added to the stored value.
    pub offset: f64,
    /// Multiplies the sum: units of the sample per stored unit.
    pub scale: f64,
}

impl Axis {
    fn value(&self, record: &[u8]) -> Option<f64> {
        Some((self.place.value(record)? as f64 + self.offset) * self.scale)
    }
}

/// Three axes of a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triad {
    /// The axes that the chip has. An axis that is absent reads 0.
    pub axes: [Option<Axis>; 3],
    /// The kernel's mounting matrix, from the chip's axes to those of the unit.
    pub matrix: Matrix3<f64>,
}

impl Triad {
    fn values(&self, record: &[u8]) -> Option<[f64; 3]> {
        let mut chip = Vector3::zeros();
        for (value, axis) in chip.iter_mut().zip(&self.axes) {
            if let Some(axis) = axis {
                *value = axis.value(record)?;
            }
        }
        Some((self.matrix * chip).into())
    }
}

/// Makes samples of the records of one layout.
#[derive(Debug, Clone, PartialEq)]
pub struct Decoder {
    angular: Triad,
    force: Option<Triad>,
    time: Option<Place>,
    record_bytes: usize,
}

impl Decoder {
    /// A decoder for records of this layout. Without `time`, samples have the time at which they were read.
    #[must_use]
    pub fn new(layout: &Layout, angular: Triad, force: Option<Triad>, time: Option<Place>) -> Self {
        Self { angular, force, time, record_bytes: layout.record_bytes() }
    }

    /// Number of bytes of a record.
    #[must_use]
    pub fn record_bytes(&self) -> usize {
        self.record_bytes
    }

    /// The sample in a record that was read at `read_ns`; `None` if the record is too short or its time is negative.
    #[must_use]
    pub fn decode(&self, record: &[u8], read_ns: u64) -> Option<ImuSample> {
        let time_ns = match &self.time {
            Some(place) => u64::try_from(place.value(record)?).ok()?,
            None => read_ns,
        };
        let angular_radps = self.angular.values(record)?;
        let force_mps2 = match &self.force {
            Some(triad) => Some(triad.values(record)?),
            None => None,
        };
        Some(ImuSample { time_ns, angular_radps, force_mps2 })
    }
}

#[cfg(test)]
mod tests {
    use super::super::Element;
    use super::*;

    fn layout(names: &[&str], kind: &str) -> Layout {
        let element = |(index, name): (u32, &&str)| Element {
            name: (*name).to_owned(),
            index,
            kind: kind.parse().unwrap(),
        };
        Layout::new((0..).zip(names).map(element).collect())
    }

    fn axis(layout: &Layout, name: &str, offset: f64, scale: f64) -> Option<Axis> {
        Some(Axis { place: layout.place(name)?, offset, scale })
    }

    #[test]
    fn values_have_their_offset_and_scale_and_an_absent_axis_reads_zero() {
        let layout = layout(&["x", "z"], "le:s16/16>>0");
        let axes = [axis(&layout, "x", 10.0, 0.5), None, axis(&layout, "z", 0.0, -2.0)];
        let angular = Triad { axes, matrix: Matrix3::identity() };
        let decoder = Decoder::new(&layout, angular, None, None);
        assert_eq!(decoder.record_bytes(), 4);
        let sample = decoder.decode(&[0xff, 0xff, 3, 0], 77).unwrap();
        let expected = ImuSample { time_ns: 77, angular_radps: [4.5, 0.0, -6.0], force_mps2: None };
        assert_eq!(sample, expected);
        assert_eq!(decoder.decode(&[0xff, 0xff, 3], 77), None, "the record is cut");
    }

    #[test]
    fn the_mounting_matrix_multiplies_the_values_of_the_chip() {
        let layout = layout(&["x", "y", "z"], "le:s8/8>>0");
        let axes = ["x", "y", "z"].map(|name| axis(&layout, name, 0.0, 1.0));
        // The ABI: the result is the matrix times the sample. The chip's x points along the unit's y.
        let matrix = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        let decoder = Decoder::new(&layout, Triad { axes, matrix }, None, None);
        assert_eq!(decoder.decode(&[1, 2, 3], 0).unwrap().angular_radps, [-2.0, 1.0, 3.0]);
    }

    #[test]
    fn a_time_before_the_start_of_the_clock_is_no_sample() {
        let layout = layout(&["z", "time"], "le:s64/64>>0");
        let axes = [None, None, axis(&layout, "z", 0.0, 1.0)];
        let angular = Triad { axes, matrix: Matrix3::identity() };
        let decoder = Decoder::new(&layout, angular, None, layout.place("time"));
        let record = |time_ns: i64| [5_i64.to_le_bytes(), time_ns.to_le_bytes()].concat();
        assert_eq!(decoder.decode(&record(9), 77).map(|sample| sample.time_ns), Some(9));
        assert_eq!(decoder.decode(&record(-1), 77), None);
    }
}
