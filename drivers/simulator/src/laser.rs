//! Simulation of a planar laser scanner.

use hal::{LaserScan, Pose3, Range, ScanGeometry};
use nalgebra::Vector3;
use rand::{Rng, RngExt};
use rayon::prelude::*;

use crate::body::Capsule;
use crate::random::normal;
use crate::render::{Hit, Renderer};
use crate::scene::LidarResponse;

/// Measurement model of a scanner: beam geometry, noise and losses.
#[derive(Debug, Clone, PartialEq)]
pub struct LaserModel {
    pub geometry: ScanGeometry,
    /// Standard deviation of ranges up to [`Self::near_m`], metres.
    pub noise_near_m: f64,
    /// Standard deviation of longer ranges, metres.
    pub noise_far_m: f64,
    /// Range at which the standard deviation changes, metres.
    pub near_m: f64,
    /// Probability that a beam returns nothing although it hit a surface.
    pub dropout: f64,
    /// Beams that hit a surface at less than this angle to it are lost, radians.
    pub grazing_rad: f64,
    /// Whether beams pass glass and do not return from black lacquer and windows, unless they hit
    /// these within `mirror_rad` of the perpendicular.
    pub misses_materials: bool,
    pub mirror_rad: f64,
    /// Beyond a third of the maximum range, beams are lost on surfaces with less than this
    /// reflectance, 0 to 1.
    pub dark_reflectance: f32,
}

impl LaserModel {
    /// Hokuyo UTM-30LX, from its data sheet: repeated accuracy sigma < 10 mm from 0.1 to 10 m and <
    /// 30 mm from 10 to 30 m. The losses (one beam in a thousand, less than 3 degrees to the
    /// surface, dark surfaces far away, glass and lacquer beyond 5 degrees from the perpendicular)
    /// are our own choice.
    pub const UTM_30LX: Self = Self {
        geometry: ScanGeometry::UTM_30LX,
        noise_near_m: 0.01,
        noise_far_m: 0.03,
        near_m: 10.0,
        dropout: 0.001,
        grazing_rad: 0.052,
        misses_materials: true,
        mirror_rad: 0.087,
        dark_reflectance: 0.02,
    };

    /// The beam geometry of the UTM-30LX, without noise or losses.
    pub const IDEAL: Self = Self {
        noise_near_m: 0.0,
        noise_far_m: 0.0,
        dropout: 0.0,
        grazing_rad: 0.0,
        misses_materials: false,
        dark_reflectance: 0.0,
        ..Self::UTM_30LX
    };

    fn hit(
        &self,
        renderer: &Renderer,
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        bodies: &[Capsule],
    ) -> Option<Hit> {
        // Slightly farther than the maximum range, because noise can bring a return into it.
        let reach_m = f64::from(self.geometry.range_max_m) + 4.0 * self.noise_far_m;
        let [origin, direction] = [*origin, *direction].map(Into::into);
        renderer.hit(origin, direction, reach_m, bodies, self.misses_materials)
    }

    fn measure(&self, hit: Option<Hit>, direction: &Vector3<f64>, rng: &mut impl Rng) -> Range {
        // Every beam draws the same number of random values whatever it hits, so that a change of
        // one beam does not change the noise of the others.
        let lost = rng.random::<f64>() < self.dropout;
        let noise = normal(rng);
        let Some(hit) = hit else { return Range::NoReturn };
        let min_m = f64::from(self.geometry.range_min_m);
        let max_m = f64::from(self.geometry.range_max_m);
        let facing = Vector3::from(hit.normal).dot(direction).abs();
        let too_dark = hit.reflectance < self.dark_reflectance && hit.distance_m > max_m / 3.0;
        let mirrored_away = self.misses_materials
            && hit.lidar == LidarResponse::Absorbing
            && facing < self.mirror_rad.cos();
        if lost || mirrored_away || facing < self.grazing_rad.sin() || too_dark {
            return Range::NoReturn;
        }
        let sigma =
            if hit.distance_m <= self.near_m { self.noise_near_m } else { self.noise_far_m };
        let measured = hit.distance_m + sigma * noise;
        if measured < min_m {
            Range::TooNear
        } else if measured > max_m {
            Range::NoReturn
        } else {
            Range::Hit(measured as f32)
        }
    }
}

/// Time from the start of a revolution to a beam, nanoseconds: a scanner of 270 degrees at 40 Hz measures its first beam
/// after 3.1 ms and its last after 21.9 ms of 25 ms.
#[must_use]
pub fn beam_after_ns(geometry: &ScanGeometry, beam: usize) -> u64 {
    let period_ns = geometry.period_ns as f64;
    (0.5 * period_ns + geometry.after_middle_s(beam) * 1e9).clamp(0.0, period_ns) as u64
}

/// Measures one beam from `t_world_laser`, in a direction counter-clockwise from its x axis, radians.
pub fn beam(
    renderer: &Renderer,
    t_world_laser: &Pose3,
    angle_rad: f64,
    bodies: &[Capsule],
    model: &LaserModel,
    rng: &mut impl Rng,
) -> Range {
    let (origin, direction) = ray(t_world_laser, angle_rad);
    model.measure(model.hit(renderer, &origin, &direction, bodies), &direction, rng)
}

fn ray(t_world_laser: &Pose3, angle_rad: f64) -> (Vector3<f64>, Vector3<f64>) {
    let (sin, cos) = angle_rad.sin_cos();
    (t_world_laser.translation.vector, t_world_laser.rotation * Vector3::new(cos, sin, 0.0))
}

/// Takes one scan into `scan`. `t_world_laser` gives the pose of the scanner while it measures a
/// beam: it moves during a scan.
pub fn scan(
    renderer: &Renderer,
    t_world_laser: impl Fn(usize) -> Pose3,
    bodies: &[Capsule],
    model: &LaserModel,
    rng: &mut impl Rng,
    time_ns: u64,
    scan: &mut LaserScan,
) {
    let geometry = &model.geometry;
    let beams: Vec<(Vector3<f64>, Vector3<f64>)> = (0..geometry.beams)
        .map(|beam| ray(&t_world_laser(beam), geometry.angle_rad(beam)))
        .collect();
    let hits: Vec<Option<Hit>> = beams
        .par_iter()
        .with_min_len(64)
        .map(|(origin, direction)| model.hit(renderer, origin, direction, bodies))
        .collect();
    scan.time_ns = time_ns;
    scan.geometry = *geometry;
    scan.ranges.clear();
    scan.ranges.extend(
        hits.iter().zip(&beams).map(|(hit, (_, direction))| model.measure(*hit, direction, rng)),
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::tests::{plain, room};
    use crate::scene::{Material, Scene, Triangle, Vertex};
    use hal::Pose2;
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    fn hall(size: [f32; 3], color: f32) -> Renderer {
        let scene = Scene {
            triangles: room(size, 0),
            materials: vec![plain([color; 3])],
            textures: vec![],
        };
        Renderer::new(&scene)
    }

    fn take(renderer: &Renderer, x_m: f64, y_m: f64, model: &LaserModel, seed: u64) -> LaserScan {
        let mut out = LaserScan::empty(model.geometry);
        let pose = Pose2::new(x_m, y_m, 0.4).to_pose3() * Pose3::translation(0.0, 0.0, 0.3);
        scan(renderer, |_| pose, &[], model, &mut Pcg64Mcg::seed_from_u64(seed), 7, &mut out);
        out
    }

    #[test]
    fn a_box_room_gives_the_geometric_distances() {
        let scan = take(&hall([8.0, 6.0, 2.6], 0.5), 3.0, 2.0, &LaserModel::IDEAL, 0);
        assert_eq!((scan.time_ns, scan.ranges.len()), (7, 1081));
        for (beam, range) in scan.ranges.iter().enumerate() {
            let (sin, cos) = (scan.geometry.angle_rad(beam) + 0.4).sin_cos();
            // Along each axis, the wall ahead; infinitely far for a beam along the other axis.
            let to_x = (5.0 / cos).max(-3.0 / cos);
            let to_y = (4.0 / sin).max(-2.0 / sin);
            let expected = to_x.min(to_y);
            assert!(
                (f64::from(range.hit_m().unwrap()) - expected).abs() < 1e-4,
                "beam {beam}: {range:?} for {expected}"
            );
        }
    }

    #[test]
    fn noise_has_the_spread_of_the_data_sheet_near_and_far() {
        let model = LaserModel { dropout: 0.0, grazing_rad: 0.0, ..LaserModel::UTM_30LX };
        for (size, sigma) in [([8.0, 8.0, 2.0], 0.01), ([40.0, 40.0, 2.0], 0.03)] {
            let renderer = hall(size, 0.5);
            let middle = f64::from(size[0]) / 2.0;
            let truth = take(&renderer, middle, middle, &LaserModel::IDEAL, 0);
            let errors: Vec<f64> = (0..8)
                .flat_map(|seed| {
                    let scan = take(&renderer, middle, middle, &model, seed);
                    let pairs = scan.ranges.into_iter().zip(truth.ranges.clone());
                    pairs
                        .filter_map(|(a, b)| Some(f64::from(a.hit_m()? - b.hit_m()?)))
                        .collect::<Vec<_>>()
                })
                .collect();
            let count = errors.len() as f64;
            let mean = errors.iter().sum::<f64>() / count;
            let spread = (errors.iter().map(|e| e * e).sum::<f64>() / count).sqrt();
            assert!(mean.abs() < 4.0 * sigma / count.sqrt(), "mean {mean}");
            assert!((spread / sigma - 1.0).abs() < 0.05, "spread {spread} for {sigma}");
        }
    }

    #[test]
    fn beams_drop_out_at_the_given_rate() {
        let model = LaserModel { dropout: 0.1, grazing_rad: 0.0, ..LaserModel::UTM_30LX };
        let renderer = hall([6.0, 6.0, 2.0], 0.5);
        let lost: usize = (0..10)
            .map(|seed| {
                take(&renderer, 3.0, 3.0, &model, seed)
                    .ranges
                    .iter()
                    .filter(|r| **r == Range::NoReturn)
                    .count()
            })
            .sum();
        let rate = lost as f64 / 10810.0;
        assert!((rate - 0.1).abs() < 0.012, "{rate}");
    }

    #[test]
    fn beams_along_a_wall_and_onto_black_far_away_are_lost() {
        let grazing = LaserModel { grazing_rad: 0.2, ..LaserModel::IDEAL };
        let scan = take(&hall([20.0, 2.0, 2.0], 0.5), 1.0, 1.0, &grazing, 0);
        assert!(is_lost(0.15, &scan) && !is_lost(0.3, &scan) && !is_lost(0.0, &scan));
        let black = LaserModel { dark_reflectance: 0.05, ..LaserModel::IDEAL };
        let scan = take(&hall([26.0, 4.0, 2.0], 0.01), 13.0, 2.0, &black, 0);
        for (_, range_m) in scan.hits() {
            assert!(range_m <= 10.0 + 1e-3);
        }
        assert!(scan.ranges.contains(&Range::NoReturn));
    }

    /// A room of 5 by 4 m, and in it a wall of another material at x = 3.
    fn divided(lidar: LidarResponse) -> Renderer {
        let mut triangles = room([5.0, 4.0, 2.5], 0);
        for corners in [[(0.0, 0.0), (4.0, 0.0), (4.0, 2.5)], [(0.0, 0.0), (4.0, 2.5), (0.0, 2.5)]]
        {
            let vertices =
                corners.map(|(y, z)| Vertex { position_m: [3.0, y, z], ..Vertex::default() });
            triangles.push(Triangle { vertices, material: 1 });
        }
        let materials = vec![plain([0.5; 3]), Material { lidar, ..plain([0.5; 3]) }];
        Renderer::new(&Scene { triangles, materials, textures: vec![] })
    }

    fn ahead_and_aside(lidar: LidarResponse, model: &LaserModel) -> [Range; 2] {
        let scan = take(&divided(lidar), 1.0, 2.0, model, 0);
        [range_towards(0.0, &scan), range_towards(0.3, &scan)]
    }

    #[test]
    fn a_beam_passes_glass_and_is_lost_on_lacquer_except_from_the_perpendicular() {
        let model = LaserModel { misses_materials: true, ..LaserModel::IDEAL };
        let [ahead, aside] = ahead_and_aside(LidarResponse::Diffuse, &model);
        assert!(is_near(ahead, 2.0) && is_near(aside, 2.0 / 0.3_f32.cos()));
        let [ahead, aside] = ahead_and_aside(LidarResponse::Glass, &model);
        assert!(is_near(ahead, 4.0) && is_near(aside, 4.0 / 0.3_f32.cos()), "{ahead:?} {aside:?}");
        let [ahead, aside] = ahead_and_aside(LidarResponse::Absorbing, &model);
        assert!(is_near(ahead, 2.0) && aside == Range::NoReturn, "{ahead:?} {aside:?}");
        // Without this property the scanner sees what the camera sees.
        for lidar in [LidarResponse::Glass, LidarResponse::Absorbing] {
            let [ahead, aside] = ahead_and_aside(lidar, &LaserModel::IDEAL);
            assert!(is_near(ahead, 2.0) && is_near(aside, 2.0 / 0.3_f32.cos()));
        }
    }

    fn is_near(range: Range, expected_m: f32) -> bool {
        (range.hit_m().unwrap() - expected_m).abs() < 0.01
    }

    fn is_lost(angle_rad: f64, scan: &LaserScan) -> bool {
        let beam = ((angle_rad - 0.4 - scan.geometry.angle_min_rad)
            / scan.geometry.angle_increment_rad)
            .round();
        scan.ranges[beam as usize] == Range::NoReturn
    }

    #[test]
    fn ranges_below_the_minimum_and_above_the_maximum_are_distinguished() {
        // The scanner is 5 cm from the wall x = 0; the opposite wall is 60 m away.
        let scan = take(&hall([60.0, 8.0, 2.0], 0.5), 0.05, 4.0, &LaserModel::IDEAL, 0);
        assert_eq!(range_towards(0.0, &scan), Range::NoReturn);
        assert_eq!(range_towards(2.7, &scan), Range::TooNear);
        assert!(range_towards(1.5, &scan).hit_m().is_some());
    }

    fn range_towards(angle_rad: f64, scan: &LaserScan) -> Range {
        let beam = ((angle_rad - 0.4 - scan.geometry.angle_min_rad)
            / scan.geometry.angle_increment_rad)
            .round();
        scan.ranges[beam as usize]
    }

    #[test]
    fn a_scanner_of_270_degrees_measures_for_three_quarters_of_its_period() {
        let geometry = ScanGeometry::UTM_30LX;
        assert_eq!(beam_after_ns(&geometry, 540), 12_500_000, "straight ahead");
        let [first, last] = [0, 1080].map(|beam| beam_after_ns(&geometry, beam) as i64);
        assert!((first - 3_125_000).abs() <= 1 && (last - 21_875_000).abs() <= 1);
    }

    #[test]
    fn a_scan_of_a_rotating_scanner_is_distorted_as_its_beams_come_one_after_the_other() {
        let renderer = hall([8.0, 6.0, 2.6], 0.5);
        let model = LaserModel::IDEAL;
        let radps = 2.0;
        let yaws: Vec<f64> = (0..model.geometry.beams)
            .map(|beam| radps * (beam_after_ns(&model.geometry, beam) as f64 * 1e-9 - 0.0125))
            .collect();
        let mut out = LaserScan::empty(model.geometry);
        let mut rng = Pcg64Mcg::seed_from_u64(0);
        let t_base_laser = Pose3::translation(0.0, 0.0, 0.3);
        scan(
            &renderer,
            |beam| Pose2::new(3.0, 2.0, yaws[beam]).to_pose3() * t_base_laser,
            &[],
            &model,
            &mut rng,
            7,
            &mut out,
        );
        for (beam, range) in out.ranges.iter().enumerate() {
            let (sin, cos) = (out.geometry.angle_rad(beam) + yaws[beam]).sin_cos();
            // Along each axis, the wall ahead; infinitely far for a beam along the other axis.
            let to_x = (5.0 / cos).max(-3.0 / cos);
            let to_y = (4.0 / sin).max(-2.0 / sin);
            let expected = to_x.min(to_y);
            assert!((f64::from(range.hit_m().unwrap()) - expected).abs() < 1e-4, "beam {beam}");
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_scan() {
        let renderer = hall([6.0, 6.0, 2.0], 0.5);
        assert!(
            take_ranges(1, &renderer) == take_ranges(1, &renderer)
                && take_ranges(1, &renderer) != take_ranges(2, &renderer)
        );
    }

    fn take_ranges(seed: u64, renderer: &Renderer) -> Vec<Range> {
        take(renderer, 2.0, 3.0, &LaserModel::UTM_30LX, seed).ranges
    }
}
