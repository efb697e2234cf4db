//! Encodes images for streaming.

use hal::DepthMap;
use image::{
    ExtendedColorType, ImageEncoder as _, ImageResult,
    codecs::{jpeg::JpegEncoder, png::PngEncoder},
};
use runtime::recording::MapView;

/// JPEG of an RGB8 image. It has a tenth of the size, and its losses do not matter for viewing.
pub(super) fn jpeg(width: usize, height: usize, rgb: &[u8]) -> ImageResult<Vec<u8>> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, 85).encode(
        rgb,
        width as u32,
        height as u32,
        ExtendedColorType::Rgb8,
    )?;
    Ok(bytes)
}

/// Grey PNG of a map with the largest y on top: occupied is dark, unknown grey, free light.
pub(super) fn map_png(map: &MapView) -> ImageResult<Vec<u8>> {
    let columns = map.columns.max(1);
    let rows = map.occupancy.chunks_exact(columns).rev();
    let gray: Vec<u8> = rows.flatten().map(|occupancy| gray(*occupancy)).collect();
    let mut bytes = Vec::new();
    let height = gray.len() / columns;
    PngEncoder::new(&mut bytes).write_image(
        &gray,
        columns as u32,
        height as u32,
        ExtendedColorType::L8,
    )?;
    Ok(bytes)
}

fn gray(occupancy: i8) -> u8 {
    match u8::try_from(occupancy) {
        Err(_) => 150,
        Ok(percent) => 250 - 2 * percent.min(100),
    }
}

/// Depth in millimetres as little-endian 16-bit values, like a depth camera; 0 is no depth.
pub(super) fn depth_mm(depth: &DepthMap) -> Vec<u8> {
    depth
        .values()
        .iter()
        .flat_map(|depth_m| ((depth_m * 1000.0).round() as u16).to_le_bytes())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_has_its_largest_y_on_top() {
        let map = MapView {
            origin_m: [0.0, 0.0],
            cell_m: 0.1,
            columns: 2,
            occupancy: vec![-1, 0, 100, 100],
        };
        let decoded = image::load_from_memory(&map_png(&map).unwrap()).unwrap().into_luma8();
        assert_eq!(decoded.into_raw(), [50, 50, 150, 250]);
    }

    #[test]
    fn depth_is_in_millimetres_and_saturates() {
        let depth = DepthMap::from_vec(3, 1, vec![0.0, 1.2345, 100.0]).unwrap();
        assert_eq!(
            depth_mm(&depth),
            [[0, 0], 1235u16.to_le_bytes(), u16::MAX.to_le_bytes()].concat()
        );
    }

    #[test]
    fn an_empty_map_does_not_panic() {
        assert!(jpeg(8, 8, &[0; 8 * 8 * 3]).is_ok());
        let empty = MapView { origin_m: [0.0, 0.0], cell_m: 0.1, columns: 0, occupancy: vec![] };
        assert!(map_png(&empty).is_err() || map_png(&empty).is_ok_and(|bytes| !bytes.is_empty()));
    }
}
