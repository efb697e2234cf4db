//! Poses of links in a robot description (URDF).
//!
//! Only the tree of joints is read: names, parents, children and origins. The XML is parsed by `roxmltree` and not by `urdf-rs`,
//! which brings three parsers of XML for geometries, materials and transmissions that nothing here needs.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use hal::Pose3;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use roxmltree::{Document, Node};

/// The links of a robot and the joints between them.
#[derive(Debug)]
pub struct Urdf {
    links: BTreeSet<String>,
    joints: Vec<Joint>,
}

#[derive(Debug)]
struct Joint {
    name: String,
    parent: String,
    child: String,
    moves: bool,
    t_parent_child: Pose3,
}

/// The pose of a link.
#[derive(Debug)]
pub struct LinkPose {
    pub t_base_link: Pose3,
    /// Joints between the two that can move. The pose is that of their zero position.
    pub moving_joints: Vec<String>,
}

impl Urdf {
    /// Reads a file.
    ///
    /// # Errors
    /// When the file cannot be read, is no URDF, is a xacro file, or describes a joint wrongly.
    pub fn read(path: &Path) -> Result<Self> {
        let shown = path.display();
        let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {shown}"))?;
        Self::parse(&text).with_context(|| format!("{shown} is not a robot description"))
    }

    fn parse(text: &str) -> Result<Self> {
        let document = Document::parse(text).context("it is not XML")?;
        let robot = document.root_element();
        ensure!(
            !robot.descendants().any(is_xacro),
            "it is a xacro file: convert it by `xacro FILE > robot.urdf` first"
        );
        let name = robot.tag_name().name();
        ensure!(name == "robot", "its root element is <{name}>, and must be <robot>");
        let links = elements(robot, "link").map(|link| text_of(link, "name"));
        let joints = elements(robot, "joint").map(joint);
        Ok(Self { links: links.collect::<Result<_>>()?, joints: joints.collect::<Result<_>>()? })
    }

    /// The names of all links.
    pub fn links(&self) -> impl Iterator<Item = &str> {
        self.links.iter().map(String::as_str)
    }

    /// The pose of `link` in `base`.
    ///
    /// # Errors
    /// When one of them does not exist, or no chain of joints leads from `base` to `link`.
    pub fn pose(&self, base: &str, link: &str) -> Result<LinkPose> {
        for name in [base, link] {
            let known: Vec<&str> = self.links().collect();
            ensure!(
                self.links.contains(name),
                "there is no link `{name}`; there are: {}",
                known.join(", ")
            );
        }
        let mut found = LinkPose { t_base_link: Pose3::identity(), moving_joints: Vec::new() };
        let mut at = link;
        // A tree has fewer joints than links; more steps are a circle.
        for _ in 0..=self.joints.len() {
            if at == base {
                return Ok(found);
            }
            let Some(joint) = self.joints.iter().find(|joint| joint.child == at) else {
                bail!("no joints lead from `{base}` to `{link}`: `{at}` has no parent")
            };
            found.t_base_link = joint.t_parent_child * found.t_base_link;
            if joint.moves {
                found.moving_joints.push(joint.name.clone());
            }
            at = &joint.parent;
        }
        bail!("the joints above `{link}` form a circle")
    }
}

fn is_xacro(node: Node<'_, '_>) -> bool {
    node.tag_name().namespace().is_some_and(|namespace| namespace.contains("xacro"))
}

fn elements<'a>(parent: Node<'a, 'a>, name: &'static str) -> impl Iterator<Item = Node<'a, 'a>> {
    parent.children().filter(move |node| node.has_tag_name(name))
}

fn text_of(node: Node<'_, '_>, attribute: &str) -> Result<String> {
    let name = node.tag_name().name();
    let value = node.attribute(attribute);
    Ok(value.with_context(|| format!("a <{name}> has no `{attribute}`"))?.to_owned())
}

fn joint(node: Node<'_, '_>) -> Result<Joint> {
    let name = text_of(node, "name")?;
    read_joint(node, &name).with_context(|| format!("joint `{name}`"))
}

fn read_joint(node: Node<'_, '_>, name: &str) -> Result<Joint> {
    Ok(Joint {
        parent: link_of(node, "parent")?,
        child: link_of(node, "child")?,
        moves: text_of(node, "type")? != "fixed",
        t_parent_child: origin(node)?,
        name: name.to_owned(),
    })
}

fn link_of(joint: Node<'_, '_>, tag: &'static str) -> Result<String> {
    let end = elements(joint, tag).next().with_context(|| format!("it has no <{tag}>"))?;
    text_of(end, "link")
}

/// The pose of the element's `<origin>`: metres, and rotations about the fixed axes x, y and z in this order, radians.
fn origin(node: Node<'_, '_>) -> Result<Pose3> {
    let Some(origin) = elements(node, "origin").next() else { return Ok(Pose3::identity()) };
    ensure!(
        origin.attribute("quat_xyzw").is_none(),
        "its origin has `quat_xyzw`, which is not read: write `rpy`"
    );
    let place_m = three_numbers(origin, "xyz")?;
    let [roll, pitch, yaw] = three_numbers(origin, "rpy")?;
    let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    Ok(Pose3::from_parts(Translation3::from(Vector3::from(place_m)), rotation))
}

fn three_numbers(origin: Node<'_, '_>, attribute: &str) -> Result<[f64; 3]> {
    let Some(text) = origin.attribute(attribute) else { return Ok([0.0; 3]) };
    let numbers: Option<Vec<f64>> = text
        .split_whitespace()
        .map(|number| number.parse().ok().filter(|number: &f64| number.is_finite()))
        .collect();
    numbers
        .and_then(|numbers| numbers.try_into().ok())
        .with_context(|| format!("{attribute}=\"{text}\" must be three finite numbers"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    fn urdf(joints: &str) -> Result<Urdf> {
        let links = ["base", "mast", "head"].map(|name| format!("<link name=\"{name}\"/>"));
        Urdf::parse(&format!("<robot name=\"r\">{}{joints}</robot>", links.concat()))
    }

    const MAST: &str = "<joint name=\"a\" type=\"fixed\"><parent link=\"base\"/><child link=\"mast\"/>\
        <origin xyz=\"0.1 0 0.5\" rpy=\"0 0 1.5707963267948966\"/></joint>";
    const HEAD: &str = "<joint name=\"tilt\" type=\"revolute\"><parent link=\"mast\"/><child link=\"head\"/>\
        <origin xyz=\"0.2 0 0.3\"/></joint>";

    fn error(joints: &str, link: &str) -> String {
        let found = urdf(joints).and_then(|urdf| urdf.pose("base", link));
        format!("{:#}", found.unwrap_err())
    }

    #[test]
    fn a_chain_of_joints_adds_up_and_names_what_can_move() {
        let pose = urdf(&format!("{HEAD}{MAST}")).unwrap().pose("base", "head").unwrap();
        let Pose3 { translation, rotation } = pose.t_base_link;
        // The mast points to the left, so the head is to its left.
        assert!((translation.vector - Vector3::new(0.1, 0.2, 0.8)).norm() < 1e-12);
        assert!((rotation.euler_angles().2 - FRAC_PI_2).abs() < 1e-12);
        assert_eq!(pose.moving_joints, ["tilt"]);
    }

    #[test]
    fn rotations_are_about_fixed_axes_x_first() {
        let joint =
            MAST.replace("0 0 1.5707963267948966", "1.5707963267948966 0 1.5707963267948966");
        let pose = urdf(&joint).unwrap().pose("base", "mast").unwrap();
        let up = pose.t_base_link.rotation * Vector3::z();
        // About x it points to the right, -y; about z that is ahead, +x.
        assert!((up - Vector3::x()).norm() < 1e-12, "{up}");
    }

    #[test]
    fn a_link_that_is_missing_loose_or_in_a_circle_is_named() {
        assert!(error(MAST, "camera").contains("no link `camera`; there are: base, head, mast"));
        assert!(error(MAST, "head").contains("`head` has no parent"));
        let circle = MAST.replace("\"base\"", "\"head\"");
        assert!(error(&format!("{circle}{HEAD}"), "head").contains("form a circle"));
    }

    #[test]
    fn what_is_no_urdf_is_refused_with_what_is_wrong() {
        assert!(refused("[camera]").contains("not XML"));
        assert!(refused("<sdf/>").contains("<sdf>, and must be <robot>"));
        let xacro = "<robot xmlns:xacro=\"http://www.ros.org/wiki/xacro\"><xacro:arm/></robot>";
        assert!(refused(xacro).contains("xacro FILE > robot.urdf"));
        assert!(refused("<robot><link/></robot>").contains("a <link> has no `name`"));
        for wrong in ["0.1 0", "0.1 0 NaN", "0.1 0 up", "1 2 3 4"] {
            let said = error(&MAST.replace("0.1 0 0.5", wrong), "mast");
            assert!(said.contains("joint `a`") && said.contains("three finite numbers"), "{said}");
        }
        assert!(error(&MAST.replace("parent", "from"), "mast").contains("it has no <parent>"));
        assert!(error(&MAST.replace("rpy", "quat_xyzw"), "mast").contains("write `rpy`"));
    }

    fn refused(text: &str) -> String {
        format!("{:#}", Urdf::parse(text).unwrap_err())
    }
}
