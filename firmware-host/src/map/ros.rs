//! A map as the pair of files that ROS `map_server` loads.

use runtime::mapping::CellState;

use crate::report::known_cells::KnownCells;

/// Name of the image beside the description.
pub const PGM_FILE: &str = "map.pgm";

/// Grey values of `map_saver` (ROS 1 and Nav2).
const FREE: u8 = 254;
const UNKNOWN: u8 = 205;
const OCCUPIED: u8 = 0;

/// The image, as binary PGM: the first row has the highest y.
pub fn pgm(cells: &KnownCells) -> Vec<u8> {
    let mut bytes = format!("P5\n{} {}\n255\n", cells.width, cells.height()).into_bytes();
    for row in cells.cells.chunks_exact(cells.width).rev() {
        bytes.extend(row.iter().map(|cell| match cell {
            CellState::Free => FREE,
            CellState::Unknown => UNKNOWN,
            CellState::Occupied => OCCUPIED,
        }));
    }
    bytes
}

/// The description. Its origin is the lower left corner of the lower left pixel.
///
/// The grey value of unknown cells means an occupancy of (255 - 205) / 255 = 0.19608, which must not lie below `free_thresh`:
/// with 0.25, the default of Nav2's `map_saver`, unknown cells are loaded as free (slam_toolbox issue 587). 0.196 is the value of
/// ROS 1.
pub fn yaml(cells: &KnownCells) -> String {
    let [x_m, y_m] = cells.origin_m;
    format!(
        "image: {PGM_FILE}\nmode: trinary\nresolution: {:?}\norigin: [{x_m:?}, {y_m:?}, 0.0]\nnegate: 0\n\
         occupied_thresh: 0.65\nfree_thresh: 0.196\n",
        cells.resolution_m
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_rows() -> KnownCells {
        use CellState::{Free, Occupied, Unknown};
        KnownCells {
            width: 3,
            cells: vec![Free, Free, Occupied, Unknown, Occupied, Unknown],
            resolution_m: 0.05,
            origin_m: [-2.0, 1.5],
        }
    }

    /// What `map_server` makes of a pixel in the mode `trinary`.
    fn loaded(pixel: u8) -> i8 {
        let occupancy = (255.0 - f64::from(pixel)) / 255.0;
        if occupancy > 0.65 {
            100
        } else if occupancy < 0.196 {
            0
        } else {
            -1
        }
    }

    #[test]
    fn the_image_begins_with_the_row_of_the_highest_y() {
        let header = b"P5\n3 2\n255\n";
        let bytes = pgm(&two_rows());
        assert_eq!(&bytes[..header.len()], header);
        assert_eq!(bytes[header.len()..], [205, 0, 205, 254, 254, 0]);
    }

    #[test]
    fn map_server_loads_each_state_as_itself() {
        let states: Vec<i8> = pgm(&two_rows())[11..].iter().map(|pixel| loaded(*pixel)).collect();
        assert_eq!(states, [-1, 100, -1, 0, 0, 100]);
    }

    #[test]
    fn origin_and_resolution_are_in_metres() {
        let text = yaml(&two_rows());
        assert!(text.contains("\nresolution: 0.05\norigin: [-2.0, 1.5, 0.0]\n"), "{text}");
        assert!(text.starts_with("image: map.pgm\n"));
    }
}
