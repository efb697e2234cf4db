//! The type of depth images, which cameras with depth and depth estimators share.

use alloc::{vec, vec::Vec};

/// A depth image: the z-depth of every pixel, row-major, metres. `0.0` means "no depth here". A
/// value is never NaN, infinite or negative.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthMap {
    width: usize,
    height: usize,
    depth_m: Vec<f32>,
}

impl DepthMap {
    /// A map in which no pixel has a depth.
    #[must_use]
    pub fn none(width: usize, height: usize) -> Self {
        Self { width, height, depth_m: vec![0.0; width * height] }
    }

    /// A map of row-major values. `None` when their count is not `width * height`, or when a value
    /// is NaN, infinite or negative.
    #[must_use]
    pub fn from_vec(width: usize, height: usize, depth_m: Vec<f32>) -> Option<Self> {
        let sound = depth_m.len() == width.checked_mul(height)?
            && depth_m.iter().all(|d| d.is_finite() && *d >= 0.0);
        sound.then_some(Self { width, height, depth_m })
    }

    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// The row-major values in metres, 0 where there is no depth.
    #[must_use]
    pub fn values(&self) -> &[f32] {
        &self.depth_m
    }

    /// Mutable access to the values. The caller must keep them finite and not negative.
    #[must_use]
    pub fn values_mut(&mut self) -> &mut [f32] {
        &mut self.depth_m
    }

    /// The depth at column `u`, row `v`. `None` where there is no depth or outside the image.
    #[must_use]
    pub fn get(&self, u: usize, v: usize) -> Option<f32> {
        if u >= self.width {
            return None;
        }
        self.depth_m.get(v * self.width + u).copied().filter(|depth| *depth > 0.0)
    }

    /// Sets every pixel to "no depth".
    pub fn clear(&mut self) {
        self.depth_m.fill(0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_and_outside_are_no_depth() {
        let map = DepthMap::from_vec(2, 1, vec![0.0, 1.5]).unwrap();
        assert_eq!(
            (map.get(0, 0), map.get(1, 0), map.get(2, 0), map.get(0, 1)),
            (None, Some(1.5), None, None)
        );
    }

    #[test]
    fn nan_infinite_negative_and_miscounted_values_are_refused() {
        for bad in [f32::NAN, f32::INFINITY, -1.0] {
            assert!(DepthMap::from_vec(1, 1, vec![bad]).is_none());
        }
        assert!(DepthMap::from_vec(2, 2, vec![1.0; 3]).is_none());
    }
}
