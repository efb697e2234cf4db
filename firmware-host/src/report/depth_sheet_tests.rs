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
        dense: None,
        network: depth(3.0),
        truth: Some(ramp),
    }
}

fn sheet(rows: &[SheetRow]) -> DepthSheet<'_> {
    DepthSheet { title: "test", rows, scale: DepthScale::of(rows.iter()) }
}

fn draw(rows: &[SheetRow]) -> Canvas {
    sheet(rows).draw().unwrap().unwrap()
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
    assert_eq!(cell(&canvas, 6, 1, 5), scale.color_of(2.0).unwrap());
    assert_eq!(cell(&canvas, 6, 2, 5), scale.color_of(3.0).unwrap());
    assert_eq!(cell(&canvas, 6, 4, 10), scale.color_of(2.0).unwrap());
    assert_eq!(cell(&canvas, 6, 4, 20), scale.color_of(3.0).unwrap());
    assert_eq!(cell(&canvas, 6, 3, 10), colors::probability(f64::from(0.8_f32)));
    // The network says 3 m where the truth is 3 m (no error), then where it is 2 m (50 % too far).
    assert_eq!(cell(&canvas, 6, 5, 20), error_color(0.0));
    assert_eq!(cell(&canvas, 6, 5, 10), error_color(0.5));
}

fn columns_of(row: SheetRow) -> Vec<Column> {
    sheet(&[row]).columns()
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
fn dense_depth_has_a_column_and_its_error_is_shown() {
    let rows = [SheetRow { dense: depth(2.5), network: None, ..row() }];
    let sheet = sheet(&rows);
    assert_eq!(sheet.columns()[1..3], [Column::Coarse, Column::Dense]);
    assert_eq!(sheet.heading(Column::Error), "error of dense depth");
    let canvas = draw(&rows);
    // Dense depth says 2.5 m where the truth is 2.5 m.
    assert_eq!(cell(&canvas, 6, 5, 15), error_color(0.0));
}

#[test]
fn missing_depth_is_hatched() {
    let mut row = row();
    row.network = None;
    row.coarse.as_mut().unwrap().depth_m.fill(0.0);
    let canvas = draw(&[row]);
    let stripes = [hatch(0, 0), hatch(4, 0)];
    for u in 0..WIDTH as i64 {
        assert!(
            stripes.contains(&cell(&canvas, 5, 1, u)) && stripes.contains(&cell(&canvas, 5, 4, u))
        );
    }
}

#[test]
fn rows_of_different_sizes_are_refused_and_without_rows_there_is_no_image() {
    let small = SheetRow { width: 32, height: 32, ..row() };
    let error = sheet(&[row(), small]).draw().unwrap_err().to_string();
    assert!(error.contains("contact sheet"), "{error}");
    assert!(sheet(&[]).draw().unwrap().is_none());
    let dir = tempfile::tempdir().unwrap();
    sheet(&[]).write(dir.path()).unwrap();
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn captions_show_the_frame_number_and_the_accuracy() {
    let rows = [row()];
    let sheet = sheet(&rows);
    assert_eq!(sheet.caption(Column::Camera, &rows[0]), "frame 12");
    assert_eq!(sheet.caption(Column::Coarse, &rows[0]), "100.0 % of pixels, delta1 0.90 unscaled");
    assert_eq!(sheet.caption(Column::Error, &rows[0]), "mean 10 %");
    let without_coarse = SheetRow { coarse: None, ..row() };
    assert_eq!(sheet.caption(Column::Coarse, &without_coarse), "no depth");
}
