//! Devices in one thread and in virtual time: for simulation, scenarios and accuracy tables.

use hal::{Base, Camera, Clock, DepthMap, Frame, ImageView, Imu, ImuSample, Lidar};

use super::{Devices, SafetyTask};
use crate::safety::{Orders, Request, SafetyState};

/// A clock that steps the safety loop while it sleeps, at the rate at which a thread would step it on a robot.
pub struct VirtualTime<K, B, L> {
    clock: K,
    safety: SafetyTask<B, L>,
    period_ns: u64,
    next_ns: u64,
    request: Option<Request>,
    operator: Option<Operator>,
}

/// Gives the orders of a step. It is called before every step, with the state of the safety plane.
type Operator = Box<dyn FnMut(SafetyState) -> Orders + Send>;

impl<K: Clock, B: Base, L: Lidar> VirtualTime<K, B, L> {
    /// Steps `safety` every `period_ns` of `clock`, from now on.
    pub fn new(clock: K, safety: SafetyTask<B, L>, period_ns: u64) -> Self {
        let next_ns = clock.now_ns();
        Self { clock, safety, period_ns: period_ns.max(1), next_ns, request: None, operator: None }
    }

    /// Passes the operator's request to the next step of the safety loop.
    pub fn request(&mut self, request: Request) {
        self.request = Some(request);
    }

    /// Asks `operator` for orders before every step, so that they reach the safety plane without waiting for a tick.
    pub fn set_operator(&mut self, operator: impl FnMut(SafetyState) -> Orders + Send + 'static) {
        self.operator = Some(Box::new(operator));
    }

    fn orders(&mut self) -> Orders {
        let state = self.safety.control().plane().state();
        let orders = self.operator.as_mut().map_or_else(Orders::default, |ask| ask(state));
        // The operator's order comes after the program's own, which may be that to arm: it replaces that one.
        let request = self.request.take();
        match orders {
            Orders { request: None, emergency_stop: false, .. } => Orders { request, ..orders },
            _ => orders,
        }
    }

    /// The safety loop, for reading its state.
    pub fn safety(&self) -> &SafetyTask<B, L> {
        &self.safety
    }

    /// Brakes, disarms the base, and returns the devices.
    pub fn shut_down(self) -> (B, L) {
        self.safety.shut_down()
    }
}

impl<K: Clock, B: Base, L: Lidar> Clock for VirtualTime<K, B, L> {
    fn now_ns(&self) -> u64 {
        self.clock.now_ns()
    }

    fn sleep_until_ns(&mut self, deadline_ns: u64) {
        while self.next_ns <= deadline_ns {
            self.clock.sleep_until_ns(self.next_ns);
            let orders = self.orders();
            self.safety.step(self.clock.now_ns(), &orders);
            self.next_ns += self.period_ns;
        }
        self.clock.sleep_until_ns(deadline_ns);
    }
}

/// [`Devices`] of a clock and a camera whose frames have perception's size.
pub struct VirtualDevices<K, C> {
    clock: K,
    camera: C,
    frame: Frame,
    ground_truth: Option<GroundTruth>,
    poll_imu: Option<Box<dyn FnMut() -> Option<ImuSample>>>,
}

/// The source of depth for the depth source `truth`.
struct GroundTruth {
    read: Box<dyn FnMut(&mut DepthMap)>,
    depth: DepthMap,
}

impl<K: Clock, C: Camera> VirtualDevices<K, C> {
    /// Devices that have not fetched a frame yet.
    pub fn new(clock: K, camera: C) -> Self {
        Self { clock, camera, frame: Frame::empty(), ground_truth: None, poll_imu: None }
    }

    /// Makes `read` copy the ground-truth depth of every fetched frame, for the depth source
    /// `truth`.
    #[must_use]
    pub fn with_ground_truth(self, read: impl FnMut(&mut DepthMap) + 'static) -> Self {
        let truth = GroundTruth { read: Box::new(read), depth: DepthMap::none(0, 0) };
        Self { ground_truth: Some(truth), ..self }
    }

    /// Adds an inertial measurement unit with the axes of `base_link`. While it has an error it has no samples.
    #[must_use]
    pub fn with_imu(self, mut imu: impl Imu + 'static) -> Self {
        Self { poll_imu: Some(Box::new(move || imu.poll_sample().ok().flatten())), ..self }
    }

    /// The clock, for writing.
    pub fn clock_mut(&mut self) -> &mut K {
        &mut self.clock
    }

    /// Returns the clock, so that the caller can shut it down.
    pub fn into_clock(self) -> K {
        self.clock
    }
}

impl<K: Clock, C: Camera> Clock for VirtualDevices<K, C> {
    fn now_ns(&self) -> u64 {
        self.clock.now_ns()
    }

    fn sleep_until_ns(&mut self, deadline_ns: u64) {
        self.clock.sleep_until_ns(deadline_ns);
    }
}

impl<K: Clock, C: Camera> Devices for VirtualDevices<K, C> {
    fn poll_frame(&mut self) -> Option<u64> {
        // After a camera error there is no frame in this tick; the previous frame is never used
        // again.
        let has_frame = self.camera.poll_frame(&mut self.frame).unwrap_or(false);
        if !has_frame {
            return None;
        }
        if let Some(truth) = &mut self.ground_truth {
            (truth.read)(&mut truth.depth);
        }
        Some(self.frame.time_ns)
    }

    fn frame(&self) -> Option<ImageView<'_>> {
        self.frame.view().ok()
    }

    fn poll_imu(&mut self) -> Option<ImuSample> {
        self.poll_imu.as_mut()?()
    }

    fn truth(&self) -> Option<&DepthMap> {
        self.ground_truth.as_ref().map(|truth| &truth.depth)
    }
}
