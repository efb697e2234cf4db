use super::*;

const WIDTH: usize = 64;
const HEIGHT: usize = 32;

fn depth(depth_m: f32) -> Option<SampledDepth> {
    Some(SampledDepth {
        depth_m: vec![depth_m; WIDTH * HEIGHT],
        confidence: vec![0.8; WIDTH * HEIGHT],
        share: 1.0,
        delta1: Some(0.9),
        abs_rel: Some(0.1),
    })
}

fn row() -> SheetRow {
    let ramp = (0..WIDTH * HEIGHT).map(|index| 1.0 + (index % WIDTH) as f32 * 0.1).collect();
    SheetRow {
        frame: 12,
        width: WIDTH,
        height: HEIGHT,
        rgb: vec![[10, 20, 30]; WIDTH * HEIGHT],
        coarse: depth(2.0),
        network: depth(3.0),
        truth: Some(ramp),
    }
}

fn draw(rows: &[SheetRow]) -> Canvas {
    DepthSheet { title: "test", rows }.draw().unwrap().unwrap()
}

/// Colour of a pixel in the middle row of a cell.
fn cell(canvas: &Canvas, columns: i64, column: usize, u: i64) -> Rgb {
    let layout = Layout { columns, rows: 1, width: WIDTH as i64, height: HEIGHT as i64 };
    canvas.get(layout.x(column) + u, layout.y(0) + CAPTION + HEIGHT as i64 / 2).unwrap()
}

#[test]
fn every_column_shows_its_own_values_on_a_common_scale() {
    let rows = [row()];
    let canvas = draw(&rows);
    let scale = DepthScale::of(rows.iter());
    assert_eq!(cell(&canvas, 6, 0, 5), [10, 20, 30]);
    assert_eq!(cell(&canvas, 6, 1, 5), scale.color(2.0));
    assert_eq!(cell(&canvas, 6, 2, 5), scale.color(3.0));
    assert_eq!(cell(&canvas, 6, 4, 10), scale.color(2.0));
    assert_eq!(cell(&canvas, 6, 4, 20), scale.color(3.0));
    assert_eq!(cell(&canvas, 6, 3, 10), colors::error(1.0 - f64::from(0.8_f32)));
    // The network says 3 m where the truth is 3 m (no error), then where it is 2 m (50 % too far).
    assert_eq!(cell(&canvas, 6, 5, 20), error_color(0.0));
    assert_eq!(cell(&canvas, 6, 5, 10), error_color(0.5));
}

fn columns_of(row: SheetRow) -> Vec<Column> {
    DepthSheet { title: "", rows: &[row] }.columns()
}

#[test]
fn columns_without_data_are_left_out() {
    assert_eq!(
        columns_of(SheetRow { network: None, ..row() }),
        [Column::Camera, Column::Coarse, Column::Confidence, Column::Truth, Column::Error]
    );
    assert_eq!(
        columns_of(SheetRow { truth: None, network: None, ..row() }),
        [Column::Camera, Column::Coarse, Column::Confidence]
    );
    assert_eq!(
        columns_of(SheetRow { coarse: None, network: None, ..row() }),
        [Column::Camera, Column::Truth]
    );
}

#[test]
fn without_a_network_the_error_is_that_of_coarse_depth() {
    let rows = [SheetRow { network: None, ..row() }];
    let canvas = draw(&rows);
    assert_eq!(cell(&canvas, 5, 4, 10), error_color(0.0));
}

#[test]
fn missing_depth_is_hatched_and_never_a_colour_of_the_scale() {
    let mut row = row();
    row.network = None;
    row.coarse.as_mut().unwrap().depth_m.fill(0.0);
    let canvas = draw(&[row]);
    for u in 0..WIDTH as i64 {
        assert!(
            NO_DEPTH.contains(&cell(&canvas, 5, 1, u))
                && NO_DEPTH.contains(&cell(&canvas, 5, 4, u))
        );
    }
    for step in 0..=1000 {
        let color = near_warm(step as f32 / 1000.0);
        assert!(
            NO_DEPTH.iter().all(|gray| gray.iter().zip(color).any(|(a, b)| a.abs_diff(b) > 40)),
            "{color:?}"
        );
    }
}

#[test]
fn near_is_warm_and_equal_ratios_are_equal_steps() {
    let scale = DepthScale { near_m: 0.5, far_m: 8.0 };
    let [near, far] = [scale.color(0.5), scale.color(8.0)];
    assert!(near[0] > near[2] && far[2] > far[0], "{near:?} {far:?}");
    assert!((scale.share(1.0) - 0.25).abs() < 1e-6 && (scale.share(2.0) - 0.5).abs() < 1e-6);
    assert_eq!(scale.color(100.0), far);
}

#[test]
fn tick_labels_do_not_touch() {
    for (near_m, far_m) in [(0.9, 2.6), (0.1, 20.0), (3.0, 3.6)] {
        let ticks = DepthScale { near_m, far_m }.ticks();
        assert!(
            !ticks.is_empty() && ticks.windows(2).all(|pair| pair[1].0 - pair[0].0 > 0.1),
            "{ticks:?}"
        );
    }
    assert!(DepthScale { near_m: 0.9, far_m: 2.6 }.ticks().len() >= 3);
}

#[test]
fn the_scale_follows_the_truth_and_a_single_wall_still_has_one() {
    let scale = DepthScale::of([row()].iter());
    assert!((scale.near_m - 1.0).abs() < 0.2 && (scale.far_m - 7.3).abs() < 0.2, "{scale:?}");
    let wall = SheetRow { truth: None, network: None, ..row() };
    let scale = DepthScale::of([wall].iter());
    assert!(scale.share(2.0).is_finite() && scale.far_m > scale.near_m);
    let nothing = SheetRow { truth: None, network: None, coarse: None, ..row() };
    assert!(DepthScale::of([nothing].iter()).share(1.0).is_finite());
}

#[test]
fn rows_of_different_sizes_are_refused_and_without_rows_there_is_no_image() {
    let small = SheetRow { width: 32, height: 32, ..row() };
    let error = DepthSheet { title: "", rows: &[row(), small] }.draw().unwrap_err().to_string();
    assert!(error.contains("contact sheet"), "{error}");
    assert!(DepthSheet { title: "", rows: &[] }.draw().unwrap().is_none());
    let dir = tempfile::tempdir().unwrap();
    DepthSheet { title: "", rows: &[] }.write(dir.path()).unwrap();
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn captions_show_the_frame_number_and_the_accuracy() {
    let rows = [row()];
    let sheet = DepthSheet { title: "", rows: &rows };
    assert_eq!(sheet.caption(Column::Camera, &rows[0]), "frame 12");
    assert_eq!(sheet.caption(Column::Coarse, &rows[0]), "100 % of pixels, delta1 0.90 unscaled");
    assert_eq!(sheet.caption(Column::Error, &rows[0]), "mean 10 %");
    let without_coarse = SheetRow { coarse: None, ..row() };
    assert_eq!(sheet.caption(Column::Coarse, &without_coarse), "no depth");
}
