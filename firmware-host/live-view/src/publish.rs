//! What a client publishes as Foxglove and ROS do: a place to go to (the tool "publish" of the 3D panel), or a velocity (the panel
//! "Teleop").

use live_link::Order;
use serde::Deserialize;

/// A pose, a point or a twist, as ROS and Foxglove write them in JSON.
#[derive(Deserialize)]
struct Published {
    pose: Option<Pose>,
    point: Option<Point>,
    twist: Option<Twist>,
    linear: Option<Linear>,
    angular: Option<Angular>,
}

#[derive(Deserialize)]
struct Pose {
    position: Point,
}

#[derive(Deserialize, Clone, Copy)]
struct Twist {
    linear: Linear,
    angular: Angular,
}

#[derive(Deserialize, Clone, Copy)]
struct Point {
    x: f64,
    y: f64,
}

#[derive(Deserialize, Clone, Copy)]
struct Linear {
    x: f64,
}

#[derive(Deserialize, Clone, Copy)]
struct Angular {
    z: f64,
}

/// The order that a message of type PoseStamped, PointStamped, Twist or TwistStamped is.
///
/// # Errors
/// What is none of them, in words.
pub fn order(payload: &[u8]) -> Result<Order, String> {
    let read: Published = serde_json::from_slice(payload)
        .map_err(|error| format!("neither a pose, a point nor a twist in JSON: {error}"))?;
    let bare = read.linear.zip(read.angular).map(|(linear, angular)| Twist { linear, angular });
    if let Some(Twist { linear, angular }) = read.twist.or(bare) {
        return Ok(Order::Drive { linear_mps: linear.x, angular_radps: angular.z });
    }
    let place = read.pose.map(|pose| pose.position).or(read.point);
    let Point { x, y } = place.ok_or("the message holds neither a pose, a point nor a twist")?;
    Ok(Order::GoTo { x_m: x, y_m: y })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_and_points_are_places_twists_are_velocities_and_nothing_else_is_an_order() {
        let pose = br#"{"header":{"frame_id":"map"},"pose":{"position":{"x":1.5,"y":-2,"z":0},"orientation":{"w":1}}}"#;
        assert_eq!(order(pose), Ok(Order::GoTo { x_m: 1.5, y_m: -2.0 }));
        let point = br#"{"point":{"x":0,"y":3,"z":0}}"#;
        assert_eq!(order(point), Ok(Order::GoTo { x_m: 0.0, y_m: 3.0 }));
        let twist = r#"{"linear":{"x":0.2,"y":0,"z":0},"angular":{"x":0,"y":0,"z":-0.5}}"#;
        let drive = Order::Drive { linear_mps: 0.2, angular_radps: -0.5 };
        assert_eq!(order(twist.as_bytes()), Ok(drive));
        let stamped = format!(r#"{{"header":{{}},"twist":{twist}}}"#);
        assert_eq!(order(stamped.as_bytes()), Ok(drive));
        for other in [
            "{}",
            "",
            r#"{"pose":{}}"#,
            r#"{"point":{"x":"a","y":0,"z":0}}"#,
            r#"{"linear":{"x":1,"y":0,"z":0}}"#,
        ] {
            assert!(order(other.as_bytes()).is_err(), "{other}");
        }
    }
}
