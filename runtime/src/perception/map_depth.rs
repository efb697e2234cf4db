//! What a map may believe of dense depth.
//!
//! Dense depth holds assumptions: floor before what the scanner hit, an upright wall above it, and filled holes. Most of them are right,
//! and they correct coarse depth on blank walls. But a robot must not drive into what an assumption hides:
//!
//! * Where coarse depth has no value, a table top or stairs down may be what was not seen. There the confidence stays below what the map
//!   takes (`DepthEstimate::doubt_unseen`).
//! * Where coarse depth is nearer, it may be a table top before the wall that the scanner sees between its legs. Coarse depth is kept,
//!   because a touch costs more than a detour. Only if the odds p / (1 - p) of the farther depth are `FARTHER_ODDS` times as good is it
//!   a mistake of a blank wall: then the map takes neither of them.
//!
//! Where coarse depth is farther, as over stairs down, the more probable of both counts, as `dense.rs` has chosen.

use super::DepthEstimate;
use super::estimate::UNCONFIRMED;

/// From this ratio on, a depth lies behind the other one. Within 25 % two depths count as equal elsewhere, but a table top that is moved by
/// 25 % of a metre is touched.
const FARTHER: f32 = 1.05;
/// How much better the odds of the farther depth must be.
const FARTHER_ODDS: f32 = 4.0;

/// Writes what a map may believe of a frame into `map`. All three have one size; `coarse` is `None` if the frame has no coarse depth.
pub fn map_depth(map: &mut DepthEstimate, dense: &DepthEstimate, coarse: Option<&DepthEstimate>) {
    map.copy_from(dense);
    map.doubt_unseen(coarse);
    let Some(coarse) = coarse else { return };
    let nearer = coarse.depth.values().iter().zip(&coarse.confidence);
    let own = map.depth.values_mut().iter_mut().zip(&mut map.confidence);
    for ((depth_m, confidence), (near_m, near)) in own.zip(nearer) {
        if *near_m <= 0.0 || *depth_m <= FARTHER * near_m {
            continue;
        }
        if odds(*confidence) < FARTHER_ODDS * odds(*near) {
            *depth_m = *near_m;
            *confidence = *near;
        } else {
            *confidence = confidence.min(UNCONFIRMED);
        }
    }
}

fn odds(confidence: f32) -> f32 {
    let confidence = confidence.clamp(0.01, 0.99);
    confidence / (1.0 - confidence)
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::DepthMap;

    /// An estimate of one pixel.
    fn pixel(depth_m: f32, confidence: f32) -> DepthEstimate {
        DepthEstimate {
            depth: DepthMap::from_vec(1, 1, vec![depth_m]).unwrap(),
            confidence: vec![confidence],
        }
    }

    fn believed(dense: (f32, f32), coarse: Option<(f32, f32)>) -> (f32, f32) {
        let mut map = pixel(0.0, 0.0);
        let coarse = coarse.map(|(depth_m, confidence)| pixel(depth_m, confidence));
        map_depth(&mut map, &pixel(dense.0, dense.1), coarse.as_ref());
        (map.depth.values()[0], map.confidence[0])
    }

    #[test]
    fn what_no_motion_has_confirmed_stays_below_what_the_map_takes() {
        assert_eq!(believed((3.0, 0.95), None), (3.0, 0.75));
        assert_eq!(believed((3.0, 0.95), Some((0.0, 0.0))), (3.0, 0.75));
        assert_eq!(believed((3.0, 0.6), None), (3.0, 0.6));
    }

    #[test]
    fn a_wall_that_is_about_as_probable_as_the_table_before_it_does_not_hide_the_table() {
        assert_eq!(believed((3.0, 0.92), Some((1.5, 0.85))), (1.5, 0.85));
        // Odds of 9 for the table, of 32 for the wall.
        assert_eq!(believed((3.0, 0.97), Some((1.5, 0.9))), (1.5, 0.9));
    }

    #[test]
    fn where_a_wall_is_far_more_probable_the_map_takes_neither_it_nor_the_depth_before_it() {
        // Odds of 1.5 and of 19.
        assert_eq!(believed((3.0, 0.95), Some((1.5, 0.6))), (3.0, 0.75));
    }

    #[test]
    fn a_nearer_wall_replaces_coarse_depth_and_so_does_one_at_the_same_place() {
        assert_eq!(believed((1.5, 0.85), Some((3.0, 0.84))), (1.5, 0.85));
        assert_eq!(believed((1.55, 0.85), Some((1.5, 0.84))), (1.55, 0.85));
    }
}
