//! Places that a client publishes, such as Foxglove's tool "publish" in its 3D panel: the robot goes there.

use serde::Deserialize;

/// A pose or a point, as ROS and Foxglove write them in JSON.
#[derive(Deserialize)]
struct Published {
    pose: Option<Pose>,
    point: Option<Point>,
}

#[derive(Deserialize)]
struct Pose {
    position: Point,
}

#[derive(Deserialize, Clone, Copy)]
struct Point {
    x: f64,
    y: f64,
}

/// The place in a message of type PoseStamped or PointStamped.
///
/// # Errors
/// What is neither, in words.
pub fn place(payload: &[u8]) -> Result<[f64; 2], String> {
    let read: Published = serde_json::from_slice(payload)
        .map_err(|error| format!("neither a pose nor a point in JSON: {error}"))?;
    let point = read.pose.map(|pose| pose.position).or(read.point);
    let Point { x, y } = point.ok_or("the message holds neither a pose nor a point")?;
    Ok([x, y])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_and_points_are_places_and_nothing_else_is() {
        let pose = br#"{"header":{"frame_id":"map"},"pose":{"position":{"x":1.5,"y":-2,"z":0},"orientation":{"w":1}}}"#;
        assert_eq!(place(pose), Ok([1.5, -2.0]));
        assert_eq!(place(br#"{"point":{"x":0,"y":3,"z":0}}"#), Ok([0.0, 3.0]));
        for other in [&b"{}"[..], b"", br#"{"pose":{}}"#, br#"{"point":{"x":"a","y":0}}"#] {
            assert!(place(other).is_err());
        }
    }
}
