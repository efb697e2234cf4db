//! The simulated robot's devices, with injected faults, in virtual time.

use drivers::fault::{Faults, FaultyBase, FaultyCamera, FaultyClock, FaultyImu, FaultyLidar};
use runtime::recording::quantise_mm;
use runtime::safety::{Request, SafetyLoop};
use runtime::session::{SafetyPort, VirtualDevices, VirtualTime, safety_link};
use simulator::SimulatedRobot;
use simulator::robot::{SimBase, SimCamera, SimClock, SimLidar};

use super::paced_clock::PacedClock;
use crate::config::Config;
use crate::control_panel::{ControlPanel, PanelReader};

type Time =
    FaultyClock<VirtualTime<PacedClock<SimClock>, FaultyBase<SimBase>, FaultyLidar<SimLidar>>>;

/// Clock and camera of a simulated robot. The safety loop, which owns wheels and scanner, steps while the clock sleeps.
pub type SimulatedDevices = VirtualDevices<Time, FaultyCamera<SimCamera>>;

/// The devices of `simulated`, armed as soon as the safety loop allows. With `maps_truth`, frames come with their true depth in
/// whole millimetres, which is what recordings hold. Orders on `panel` reach the safety plane in its next step.
pub fn simulated_devices(
    config: &Config,
    simulated: &SimulatedRobot,
    faults: &Faults,
    maps_truth: bool,
    real_time: bool,
    panel: &ControlPanel,
) -> (SimulatedDevices, SafetyPort) {
    let devices = simulated.devices();
    let base = FaultyBase::new(devices.base, faults);
    let lidar = FaultyLidar::new(devices.lidar, faults);
    let safety = SafetyLoop::new(config.simulated_safety_config(), base, lidar);
    let (task, port) = safety_link(safety);
    let mut time = VirtualTime::new(
        PacedClock::new(devices.clock, real_time),
        task,
        config.safety_period_ns(),
    );
    time.request(Request::Arm);
    let mut reader = PanelReader::new(panel.clone());
    time.set_operator(move |state| {
        reader.publish(state);
        reader.orders()
    });
    let camera = FaultyCamera::new(devices.camera, faults);
    let mut devices = VirtualDevices::new(FaultyClock::new(time, faults), camera);
    if config.simulator.imu {
        devices = devices.with_imu(FaultyImu::new(simulated.devices().imu, faults));
    }
    if maps_truth {
        let world = simulated.devices().truth;
        devices = devices.with_ground_truth(move |depth| {
            world.depth(depth);
            quantise_mm(depth);
        });
    }
    (devices, port)
}
