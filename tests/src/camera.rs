//! A camera that misbehaves.

use hal::{Camera, CameraModel, ErrorType, Frame};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::{Seconds, holds};

/// What goes wrong, and when.
#[derive(Debug, Clone, Default)]
pub struct CameraFaults {
    /// No picture is handed out: the camera is unplugged.
    pub unplugged: Option<Seconds>,
    /// Pictures are black: the lens is covered.
    pub black: Option<Seconds>,
    /// Pictures are white: the sun shines in.
    pub saturated: Option<Seconds>,
    /// Pictures have half the height: somebody changed the mode.
    pub wrong_size: Option<Seconds>,
    /// Share of pictures that are lost at any time.
    pub drop_share: f64,
}

/// The wrapper.
#[derive(Debug)]
pub struct FaultyCamera<C> {
    inner: C,
    faults: CameraFaults,
    rng: Pcg64Mcg,
}

impl<C> FaultyCamera<C> {
    /// Wraps a camera.
    pub fn new(inner: C, faults: CameraFaults, seed: u64) -> Self {
        Self { inner, faults, rng: Pcg64Mcg::seed_from_u64(seed) }
    }
}

impl<C: ErrorType> ErrorType for FaultyCamera<C> {
    type Error = C::Error;
}

impl<C: Camera> Camera for FaultyCamera<C> {
    fn model(&self) -> &CameraModel {
        self.inner.model()
    }

    fn poll_frame(&mut self, frame: &mut Frame) -> Result<bool, Self::Error> {
        if !self.inner.poll_frame(frame)? {
            return Ok(false);
        }
        let now_ns = frame.time_ns;
        if holds(self.faults.black.as_ref(), now_ns) {
            frame.data.fill(0);
        }
        if holds(self.faults.saturated.as_ref(), now_ns) {
            frame.data.fill(255);
        }
        if holds(self.faults.wrong_size.as_ref(), now_ns) {
            frame.height /= 2;
            frame.data.truncate(frame.width * frame.height * 3);
        }
        let lost = self.rng.random::<f64>() < self.faults.drop_share;
        Ok(!lost && !holds(self.faults.unplugged.as_ref(), now_ns))
    }
}
