//! A layout for Foxglove: map with robot, scan, path and goal; camera and depth; state; plots; log; buttons.

use live_link::Order;
use serde_json::{Value, json};

use crate::protocol::service_name;

/// The layout, as Foxglove imports it.
#[must_use]
pub fn layout() -> Value {
    let mut configs = json!({
        "3D!map": {
            "cameraState": {
                "perspective": false, "distance": 16, "phi": 0, "thetaOffset": 90,
                "target": [0, 0, 0], "targetOffset": [0, 0, 0], "targetOrientation": [0, 0, 0, 1],
                "fovy": 45, "near": 0.5, "far": 5000
            },
            "followMode": "follow-position", "followTf": "base_link", "fixedFrame": "map",
            "scene": {"transforms": {"showLabel": false, "axisScale": 0.5}},
            "topics": {
                "/map": {"visible": true, "colorMode": "rgba-fields"},
                "/scan": {"visible": true, "colorMode": "flat", "flatColor": "#d55e00", "pointSize": 3},
                "/path": {"visible": true, "type": "line", "lineWidth": 0.05, "gradient": ["#0072b2", "#0072b2"]},
                "/goal": {"visible": true, "axisScale": 0.4},
                "/keep_out": {"visible": true},
                "/pose": {"visible": true, "type": "arrow", "color": "#009e73", "arrowScale": [0.5, 0.1, 0.1]}
            },
            "publish": {"type": "pose", "poseTopic": "/goal_pose", "pointTopic": "/clicked_point"},
            "layers": {}
        },
        "Image!camera": {"imageMode": {"imageTopic": "/camera/image", "calibrationTopic": "/camera/calibration"}},
        "Image!depth": {"imageMode": {"imageTopic": "/depth/image"}},
        "RawMessages!now": {"topicPath": "/robot/now", "diffEnabled": false},
        "RosOut!events": {"topicToRender": "/events", "searchTerms": [], "minLogLevel": 1},
        "Plot!ticks": plot("Time of a tick, ms", &["/robot/now.tick_ms", "/robot/health.exploration.tick_p99_ms"]),
        // Ten messages a second while a button is pressed; the robot stands 0.4 s after the last one.
        "Teleop!drive": {
            "topic": "/cmd_vel", "publishRate": 10, "foxglovePanelTitle": "Drive by hand",
            "upButton": {"field": "linear-x", "value": 0.2}, "downButton": {"field": "linear-x", "value": -0.1},
            "leftButton": {"field": "angular-z", "value": 0.3}, "rightButton": {"field": "angular-z", "value": -0.3}
        },
        "Plot!speed": plot("Commands in force", &["/robot/now.linear_mps", "/robot/now.angular_radps"]),
    });
    let mut buttons = Vec::new();
    for order in Order::ALL.into_iter().filter(has_button) {
        let name = service_name(order);
        let id = format!("CallService!{name}");
        if let Some(configs) = configs.as_object_mut() {
            configs.insert(id.clone(), button(name));
        }
        buttons.push(json!(id));
    }
    let buttons = buttons.into_iter().rev().reduce(|rest, next| beside("column", 30, &next, &rest));
    let images = beside("column", 50, &json!("Image!camera"), &json!("Image!depth"));
    let plots = beside("column", 50, &json!("Plot!ticks"), &json!("Plot!speed"));
    let texts = beside("column", 50, &json!("RawMessages!now"), &json!("RosOut!events"));
    let left = beside("column", 65, &json!("3D!map"), &beside("row", 50, &texts, &plots));
    let orders = beside("column", 75, &buttons.unwrap_or(Value::Null), &json!("Teleop!drive"));
    let right = beside("column", 45, &images, &orders);
    json!({
        "configById": configs,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": beside("row", 68, &left, &right),
    })
}

/// What needs another velocity, area or policy each time has no button.
fn has_button(order: &Order) -> bool {
    !matches!(order, Order::Drive { .. } | Order::KeepOut { .. } | Order::ExploreBy { .. })
}

fn beside(direction: &str, share: u32, first: &Value, second: &Value) -> Value {
    json!({"direction": direction, "first": first, "second": second, "splitPercentage": share})
}

fn plot(title: &str, paths: &[&str]) -> Value {
    let paths: Vec<_> = paths
        .iter()
        .map(|path| json!({"value": path, "enabled": true, "timestampMethod": "receiveTime"}))
        .collect();
    json!({
        "paths": paths, "title": title, "foxglovePanelTitle": title, "showXAxisLabels": true, "showYAxisLabels": true,
        "showLegend": true, "legendDisplay": "floating", "isSynced": true, "xAxisVal": "timestamp", "followingViewWidth": 60
    })
}

fn button(name: &str) -> Value {
    let color = if name == "stop" { "#c62828" } else { "#37474f" };
    let request = if name == "go_to" { "{\"x_m\": 0, \"y_m\": 0}" } else { "{}" };
    json!({
        "serviceName": format!("/robot/{name}"), "requestPayload": request, "layout": "horizontal",
        "buttonText": name.replace('_', " "), "buttonTooltip": "", "buttonColor": color, "editingMode": false,
        "foxglovePanelTitle": name.replace('_', " ")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The names of the panels in the tree.
    fn panels(tree: &Value, found: &mut Vec<String>) {
        match tree {
            Value::String(panel) => found.push(panel.clone()),
            tree => ["first", "second"].iter().for_each(|side| panels(&tree[side], found)),
        }
    }

    #[test]
    fn every_panel_is_placed_once_and_has_a_configuration() {
        let layout = layout();
        let mut placed = Vec::new();
        panels(&layout["layout"], &mut placed);
        placed.sort();
        let configured: Vec<String> =
            layout["configById"].as_object().unwrap().keys().cloned().collect();
        let mut configured = configured;
        configured.sort();
        assert_eq!(placed, configured);
    }
}
