//! What a map may believe of dense depth.
//!
//! Dense depth holds assumptions: floor before what the scanner hit, an upright wall above it, and filled holes. Most of them are right,
//! and they correct coarse depth on blank walls. But a robot must not drive into what an assumption hides. So the map takes the depth by the
//! logistic models (`DenseDepth::before_choice`) with exceptions:
//!
//! * Where coarse depth has no value, a table top or stairs down may be what was not seen. There the confidence stays below what the map
//!   takes (`DepthEstimate::doubt_unseen`).
//! * Where coarse depth is nearer, it may be a table top before the wall that the scanner sees between its legs. Coarse depth is kept,
//!   because a touch costs more than a detour. Only if the odds p / (1 - p) of the farther depth are `FARTHER_ODDS` times as good is it
//!   a mistake of a blank wall: then the map takes neither of them.
//! * Where the best depth, after the choice and joined with a network, is of another surface, one of both is a mistake, and the map takes
//!   neither. Only a nearer depth that is more probable than the best depth stays. So choice and network add nothing to the map.
//!
//! Where coarse depth is farther, as over stairs down, the more probable of both counts, as `dense.rs` has chosen.

use super::DepthEstimate;
use super::belief::AGREEMENT;
use super::estimate::UNCONFIRMED;

/// From this ratio on, a depth lies behind the other one. Within 25 % two depths count as equal elsewhere, but a table top that is moved by
/// 25 % of a metre is touched.
const FARTHER: f32 = 1.05;
/// From this ratio on, two depths are of different surfaces (`dense::agree`).
const CONTRADICTING: f32 = 1.0 / (1.0 - AGREEMENT);
/// How much better the odds of the farther depth must be.
const FARTHER_ODDS: f32 = 4.0;

/// Writes what a map may believe of a frame into `map`. `dense` is its depth by the logistic models, `best` the best depth that there is;
/// `coarse` is `None` if the frame has no coarse depth. All have one size.
pub fn map_depth(
    map: &mut DepthEstimate,
    dense: &DepthEstimate,
    best: &DepthEstimate,
    coarse: Option<&DepthEstimate>,
) {
    map.copy_from(dense);
    map.doubt_unseen(coarse);
    let Some(coarse) = coarse else { return };
    let own = map.depth.values_mut().iter_mut().zip(&mut map.confidence);
    let others = pixels(best).zip(pixels(coarse));
    for ((depth_m, confidence), (best, coarse)) in own.zip(others) {
        let own = Pixel { depth_m: *depth_m, confidence: *confidence };
        let believed = believed(own, best, coarse);
        *depth_m = believed.depth_m;
        *confidence = believed.confidence;
    }
}

/// One pixel of an estimate.
#[derive(Debug, Clone, Copy)]
struct Pixel {
    /// 0 where there is no depth.
    depth_m: f32,
    confidence: f32,
}

fn pixels(estimate: &DepthEstimate) -> impl Iterator<Item = Pixel> {
    let pixels = estimate.depth.values().iter().zip(&estimate.confidence);
    pixels.map(|(depth_m, confidence)| Pixel { depth_m: *depth_m, confidence: *confidence })
}

/// What a map may believe of a pixel with the depth `own`.
fn believed(own: Pixel, best: Pixel, coarse: Pixel) -> Pixel {
    let is_behind_coarse = coarse.depth_m > 0.0 && own.depth_m > FARTHER * coarse.depth_m;
    if is_behind_coarse && odds(own.confidence) < FARTHER_ODDS * odds(coarse.confidence) {
        return coarse;
    }
    let may_hide = own.depth_m > CONTRADICTING * best.depth_m;
    let may_be_imagined =
        best.depth_m > CONTRADICTING * own.depth_m && best.confidence >= own.confidence;
    if is_behind_coarse || may_hide || may_be_imagined {
        return Pixel { confidence: own.confidence.min(UNCONFIRMED), ..own };
    }
    own
}

fn odds(confidence: f32) -> f32 {
    let confidence = confidence.clamp(0.01, 0.99);
    confidence / (1.0 - confidence)
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::DepthMap;
    use proptest::prelude::*;

    /// An estimate of one pixel.
    fn pixel(depth_m: f32, confidence: f32) -> DepthEstimate {
        DepthEstimate {
            depth: DepthMap::from_vec(1, 1, vec![depth_m]).unwrap(),
            confidence: vec![confidence],
        }
    }

    /// What the map takes where the choice and a network confirm dense depth.
    fn alone(dense: (f32, f32), coarse: Option<(f32, f32)>) -> (f32, f32) {
        with_best(dense, dense, coarse)
    }

    fn with_best(dense: (f32, f32), best: (f32, f32), coarse: Option<(f32, f32)>) -> (f32, f32) {
        let mut map = pixel(0.0, 0.0);
        let coarse = coarse.map(|(depth_m, confidence)| pixel(depth_m, confidence));
        map_depth(&mut map, &pixel(dense.0, dense.1), &pixel(best.0, best.1), coarse.as_ref());
        (map.depth.values()[0], map.confidence[0])
    }

    #[test]
    fn what_no_motion_has_confirmed_stays_below_what_the_map_takes() {
        assert_eq!(alone((3.0, 0.95), None), (3.0, 0.75));
        assert_eq!(alone((3.0, 0.95), Some((0.0, 0.0))), (3.0, 0.75));
        assert_eq!(alone((3.0, 0.6), None), (3.0, 0.6));
    }

    #[test]
    fn a_wall_that_is_about_as_probable_as_the_table_before_it_does_not_hide_the_table() {
        assert_eq!(alone((3.0, 0.92), Some((1.5, 0.85))), (1.5, 0.85));
        // Odds of 9 for the table, of 32 for the wall.
        assert_eq!(alone((3.0, 0.97), Some((1.5, 0.9))), (1.5, 0.9));
    }

    #[test]
    fn where_a_wall_is_far_more_probable_the_map_takes_neither_it_nor_the_depth_before_it() {
        // Odds of 1.5 and of 19.
        assert_eq!(alone((3.0, 0.95), Some((1.5, 0.6))), (3.0, 0.75));
    }

    #[test]
    fn a_nearer_wall_replaces_coarse_depth_and_so_does_one_at_the_same_place() {
        assert_eq!(alone((1.5, 0.85), Some((3.0, 0.84))), (1.5, 0.85));
        assert_eq!(alone((1.55, 0.85), Some((1.5, 0.84))), (1.55, 0.85));
    }

    #[test]
    fn depth_that_may_hide_something_nearer_is_doubted_and_the_nearer_one_is_not_marked_either() {
        let coarse = Some((3.0, 0.85));
        assert_eq!(with_best((3.0, 0.9), (1.5, 0.6), coarse), (3.0, 0.75));
        // One surface: 12 % of the inverse depth.
        assert_eq!(with_best((3.0, 0.9), (2.7, 0.6), coarse), (3.0, 0.9));
    }

    #[test]
    fn an_obstacle_is_doubted_only_where_the_depth_behind_it_is_more_probable() {
        let coarse = Some((1.5, 0.85));
        assert_eq!(with_best((1.5, 0.85), (3.0, 0.9), coarse), (1.5, 0.75));
        assert_eq!(with_best((1.5, 0.85), (3.0, 0.8), coarse), (1.5, 0.85));
    }

    #[test]
    fn what_is_confirmed_does_not_hide_a_table_before_it() {
        assert_eq!(with_best((3.0, 0.9), (3.0, 0.99), Some((1.5, 0.85))), (1.5, 0.85));
    }

    fn any_pixel() -> impl Strategy<Value = (f32, f32)> {
        (0.3_f32..8.0, 0.02_f32..1.0)
    }

    proptest! {
        #[test]
        fn the_best_depth_only_lowers_confidences(
            dense in any_pixel(), best in any_pixel(), coarse in any_pixel(),
        ) {
            let without = alone(dense, Some(coarse));
            let with = with_best(dense, best, Some(coarse));
            prop_assert_eq!(with.0, without.0);
            prop_assert!(with.1 <= without.1);
        }
    }
}
