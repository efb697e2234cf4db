//! A flow engine allocates nothing once it has run: a robot's loop does not wait for memory.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

use hal::{CameraModel, ImageView, PixelFormat};
use nalgebra::{UnitQuaternion, Vector3};
use runtime::perception::flow::{DenseFlow, DerotatedFlow, FlowField, FlowPreset};

struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

// Counting is the only way to know; the memory itself is the system allocator's.
#[allow(unsafe_code)]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static GLOBAL: Counting = Counting;

const WIDTH: usize = 200;
const HEIGHT: usize = 150;

#[test]
fn flow_allocates_nothing_after_the_first_call() {
    let picture = |shift: usize| -> Vec<u8> {
        (0..WIDTH * HEIGHT).map(|i| ((i % WIDTH + shift) * (i / WIDTH + 3) * 37 % 251) as u8).collect()
    };
    let (first, second) = (picture(0), picture(2));
    let view = |data| ImageView::new(WIDTH, HEIGHT, PixelFormat::Gray8, data).unwrap();
    let initial = FlowField::zero(WIDTH, HEIGHT);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.02, 0.0));
    let mut derotated = DerotatedFlow::new(FlowPreset::Fast, CameraModel::pinhole(WIDTH, HEIGHT, 1.5)).unwrap();
    for preset in [FlowPreset::UltraFast, FlowPreset::Fast, FlowPreset::Medium] {
        let mut engine = DenseFlow::new(preset, WIDTH, HEIGHT).unwrap();
        let mut run = || {
            engine.flow(view(&first), view(&second), Some(&initial)).unwrap();
            derotated.flow(view(&first), view(&second), &turn).unwrap();
        };
        // Inside the pool: handing work to it from outside may take memory for its queue.
        rayon::scope(|_| {
            (0..3).for_each(|_| run());
            let before = ALLOCATIONS.load(Ordering::Relaxed);
            (0..5).for_each(|_| run());
            assert_eq!(ALLOCATIONS.load(Ordering::Relaxed) - before, 0, "{preset:?}");
        });
    }
}
