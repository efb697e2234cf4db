use super::*;

/// A room of 4 x 3 m with walls one cell (5 cm) thick. The right third is unknown.
fn room() -> Vec<CellState> {
    let width = 80;
    let height = 60;
    let mut cells = vec![CellState::Free; width * height];
    for row in 0..height {
        for column in 0..width {
            if row == 0 || row == height - 1 || column == 0 {
                cells[row * width + column] = CellState::Occupied;
            }
            if column > 55 {
                cells[row * width + column] = CellState::Unknown;
            }
        }
    }
    cells
}

fn picture<'a>(cells: &'a [CellState], trajectory: &'a [Pose2]) -> MapPlot<'a> {
    MapPlot {
        title: "test",
        figures: "",
        map: Cells { width: 80, cells, resolution_m: 0.05, origin_m: [-1.0, -2.0] },
        trajectory,
        goals: &[],
        trips: &[],
        truth: None,
    }
}

fn color_at(canvas: &Canvas, view: &View, point_m: [f64; 2]) -> Rgb {
    let [x, y] = view.pixel(point_m);
    canvas.get(x.round() as i64, y.round() as i64).unwrap()
}

#[test]
fn cells_have_their_colours_and_y_points_up() {
    let cells = room();
    let picture = picture(&cells, &[]);
    let canvas = picture.draw().unwrap();
    let view = View::of(&picture);
    assert_eq!(color_at(&canvas, &view, [0.0, -0.5]), FREE);
    assert_eq!(color_at(&canvas, &view, [0.0, 0.975]), OCCUPIED);
    assert_eq!(color_at(&canvas, &view, [2.1, -0.5]), UNKNOWN);
    assert!(view.pixel([0.0, 0.9])[1] < view.pixel([0.0, -1.9])[1]);
}

#[test]
fn the_path_has_the_colour_of_its_time() {
    let cells = room();
    let path: Vec<Pose2> =
        (0..=100).map(|i| Pose2::new(-0.5 + 0.02 * f64::from(i), -0.5, 0.0)).collect();
    let picture = picture(&cells, &path);
    let canvas = picture.draw().unwrap();
    let view = View::of(&picture);
    for index in [25, 50, 75] {
        let seen = color_at(&canvas, &view, [path[index].x_m, -0.5]);
        let expected = colors::time(index as f64 / 100.0);
        // The round end of the next line covers this point.
        assert!(
            seen.iter().zip(expected).all(|(a, b)| a.abs_diff(b) <= 6),
            "{seen:?} for {expected:?}"
        );
    }
    assert_eq!(color_at(&canvas, &view, [path[0].x_m, -0.5]), START);
    assert_eq!(color_at(&canvas, &view, [path[100].x_m, -0.5]), END, "the robot");
}

#[test]
fn the_scale_bar_is_one_metre_long() {
    let cells = room();
    let picture = picture(&cells, &[]);
    let canvas = picture.draw().unwrap();
    let view = View::of(&picture);
    let y = view.top + view.height - 18;
    let bar =
        (view.left..view.left + view.width).filter(|x| canvas.get(*x, y) == Some(INK)).count();
    assert_eq!(bar as f64, view.pixels_per_m.round());
    let length = view.pixel([1.0, 0.0])[0] - view.pixel([0.0, 0.0])[0];
    assert!((length - view.pixels_per_m).abs() < 1e-9);
}

#[test]
fn the_view_shows_the_known_area_with_a_margin() {
    let cells = room();
    let picture = picture(&cells, &[]);
    let view = View::of(&picture);
    assert!((view.min_m[0] - -1.5).abs() < 0.051 && (view.min_m[1] - -2.5).abs() < 0.051);
    // 2.8 m are known, plus the margin on both sides.
    assert!((view.width as f64 / view.pixels_per_m - 3.8).abs() < 0.11);
    let (width, _) = picture.draw().unwrap().size();
    assert!(width >= 800);
}

#[test]
fn markers_are_drawn_at_goals_and_safety_stops() {
    let cells = room();
    let goals = [Goal { at_m: [0.5, -1.0], fate: GoalFate::Reached }];
    let picture = MapPlot { goals: &goals, trips: &[[0.0, -1.5]], ..picture(&cells, &[]) };
    let canvas = picture.draw().unwrap();
    let view = View::of(&picture);
    assert_eq!(color_at(&canvas, &view, [0.0, -1.5]), TRIP);
    assert_eq!(color_at(&canvas, &view, [0.5, -1.0]), GOAL);
}

#[test]
fn a_goal_that_was_given_up_beside_a_reached_one_does_not_cover_it() {
    let cells = room();
    let goals = [
        Goal { at_m: [0.5, -1.0], fate: GoalFate::Reached },
        Goal { at_m: [0.52, -1.0], fate: GoalFate::Dropped },
        Goal { at_m: [0.5, 0.0], fate: GoalFate::Dropped },
        Goal { at_m: [0.5, -0.5], fate: GoalFate::Seen },
    ];
    let picture = MapPlot { goals: &goals, ..picture(&cells, &[]) };
    let canvas = picture.draw().unwrap();
    let view = View::of(&picture);
    assert_eq!(color_at(&canvas, &view, [0.5, -1.0]), GOAL);
    assert_eq!(color_at(&canvas, &view, [0.5, 0.0]), PAGE, "hollow");
    assert_eq!(color_at(&canvas, &view, [0.5, -0.5]), SEEN);
}

/// Truth about the room: its floor, and its left wall 0.2 m further left than in the map.
struct Home {
    floor: Vec<bool>,
    to_obstacle_m: Vec<f32>,
    path: Vec<Pose2>,
}

impl Home {
    fn new() -> Self {
        let to_obstacle_m = (0..80 * 60)
            .map(|index| ((index % 80) as f32 * 0.05 + 0.2).min((index / 80) as f32 * 0.05))
            .collect();
        let path = (0..50).map(|i| Pose2::new(0.02 * f64::from(i), 0.3, 0.0)).collect();
        Self { floor: vec![true; 40 * 30], to_obstacle_m, path }
    }

    fn truth(&self) -> TrueHome<'_> {
        let origin_m = [-1.0, -2.0];
        let to_obstacle_m = &self.to_obstacle_m[..];
        TrueHome {
            reachable: Cells { width: 40, cells: &self.floor, resolution_m: 0.1, origin_m },
            to_obstacle_m: Cells { width: 80, cells: to_obstacle_m, resolution_m: 0.05, origin_m },
            trajectory: &self.path,
        }
    }
}

#[test]
fn the_reachable_floor_is_outlined_also_where_the_map_is_unknown() {
    let cells = vec![CellState::Unknown; 80 * 60];
    let home = Home::new();
    let picture = MapPlot { truth: Some(home.truth()), ..picture(&cells, &[]) };
    let canvas = picture.draw().unwrap();
    let view = View::of(&picture);
    let [x, y] = view.pixel([3.0, -0.7]).map(|value| value.round() as i64);
    assert!(
        (x - 2..x + 2).any(|x| canvas.get(x, y).is_some_and(|[r, _, b]| b.abs_diff(r) > 50)),
        "also on a grid line"
    );
    assert_eq!(color_at(&canvas, &view, [1.52, -0.53]), UNKNOWN);
}

#[test]
fn walls_at_a_wrong_place_differ_from_right_and_from_missed_ones() {
    let mut cells = room();
    // The lower wall is right on its left half and missed on its right half.
    cells[20..40].fill(CellState::Free);
    let home = Home::new();
    let picture = MapPlot { truth: Some(home.truth()), ..picture(&cells, &[]) };
    let canvas = picture.draw().unwrap();
    let view = View::of(&picture);
    assert_eq!(color_at(&canvas, &view, [-0.976, -0.53]), OFF);
    assert_eq!(color_at(&canvas, &view, [-0.53, -1.976]), OCCUPIED);
    assert_eq!(color_at(&canvas, &view, [0.53, -1.976]), MISSED);
}

#[test]
fn the_believed_path_is_drawn_beside_the_true_one() {
    let cells = room();
    let home = Home::new();
    let believed: Vec<Pose2> =
        (0..50).map(|i| Pose2::new(0.02 * f64::from(i), -0.3, 0.0)).collect();
    let picture = MapPlot { truth: Some(home.truth()), ..picture(&cells, &believed) };
    let canvas = picture.draw().unwrap();
    let view = View::of(&picture);
    let [red, green, blue] = color_at(&canvas, &view, [0.53, -0.3]);
    assert!(green > red + 40 && green > blue + 40, "green: {red} {green} {blue}");
    let true_path = color_at(&canvas, &view, [0.53, 0.3]);
    assert!(true_path.iter().zip(colors::time(0.55)).all(|(a, b)| a.abs_diff(b) < 12));
}

#[test]
fn an_empty_run_and_poses_with_nan_still_give_an_image() {
    let cells = vec![CellState::Unknown; 80 * 60];
    assert!(picture(&cells, &[]).draw().is_ok());
    let path = [Pose2 { x_m: f64::NAN, ..Pose2::IDENTITY }, Pose2::IDENTITY];
    assert!(picture(&cells, &path).draw().is_ok());
}

#[test]
fn cells_that_do_not_fill_their_rows_are_refused() {
    let cells = vec![CellState::Free; 81];
    let error = picture(&cells, &[]).draw().unwrap_err().to_string();
    assert!(error.contains("map: 81 values for 80x1"), "{error}");
}
