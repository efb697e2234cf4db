//! What a model takes and gives, read from its inputs, outputs and metadata, and checked before anything runs.

use super::NetworkError;
use super::bound::{Port, TensorInfo};
use super::volume::REDUCTION;

/// Depth range of a model that does not name one, metres: the sensor range of Embodied Depth Prediction (Liu et al.).
pub const DEFAULT_DEPTH_RANGE_M: (f32, f32) = (0.1, 20.0);
/// No indoor or street scene is deeper; a larger number in a model is a mistake of units.
const LARGEST_DEPTH_M: f32 = 1000.0;
/// Planes of a cost volume that does not say where they are, metres.
const VOLUME_RANGE_M: (f32, f32) = (0.3, 20.0);
/// ManyDepth has 96; more than this is a mistake of the layout.
const MAX_PLANES: usize = 256;

const INPUTS: &str = "one picture [1, 3, height, width], alone or with a second input: coarse disparity, validity and \
    confidence [1, 3, height, width] (or joined with the picture in [1, 6, height, width]), or a cost volume \
    [1, planes, height / 4, width / 4]";
const ONE_OUTPUT: &str = "one output, [1, 1, height, width], or [1, 2, height, width] with log-uncertainty; export only the finest scale";

/// What enters the model. Planes lie in rows, channel after channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum InputKind {
    /// Red, green, blue in 0..1: `[1, 3, height, width]`.
    Rgb,
    /// As `Rgb`, and a second input with coarse disparity, validity and confidence in 0..1: `[1, 3, height, width]`.
    RgbAndCoarse,
    /// Both in one input: `[1, 6, height, width]`.
    RgbCoarseJoined,
    /// As `Rgb`, and a second input with the cost volume `[1, planes, height / 4, width / 4]`.
    RgbAndVolume {
        /// Planes of inverse depth, evenly spaced.
        planes: usize,
        /// Depth of the nearest and of the farthest plane, metres (metadata `volume_min_depth_m`, `volume_max_depth_m`).
        range_m: (f32, f32),
    },
}

impl InputKind {
    /// Whether the model uses the coarse depth.
    #[must_use]
    pub fn takes_coarse(self) -> bool {
        matches!(self, Self::RgbAndCoarse | Self::RgbCoarseJoined)
    }

    /// As the metadata says it.
    fn name(self) -> &'static str {
        match self {
            Self::Rgb => "rgb",
            Self::RgbAndCoarse | Self::RgbCoarseJoined => "rgb+coarse",
            Self::RgbAndVolume { .. } => "rgb+volume",
        }
    }
}

/// What the first channel of the output means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutputKind {
    /// z-depth in metres.
    Depth,
    /// x in 0..1 with disparity = 1/max + (1/min - 1/max) x and depth = 1/disparity (Godard et al. 2019, Monodepth2, section 3).
    Disparity,
}

/// Everything that must be known about a model to run it.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelSpec {
    /// What goes in.
    pub input: InputKind,
    /// What comes out.
    pub output: OutputKind,
    /// Whether a second output channel holds ln b, where b is the Laplace scale of the error of ln depth.
    pub uncertainty: bool,
    /// Smallest and largest depth that the model can say, metres.
    pub depth_range_m: (f32, f32),
    /// Columns and rows of the picture.
    pub size: (usize, usize),
    /// What the model calls itself (metadata `version`).
    pub version: Option<String>,
    /// The picture, then what else goes in.
    pub(super) input_ports: Vec<Port>,
    pub(super) output_port: Port,
}

impl ModelSpec {
    /// Reads and checks what a model says about itself against the camera's picture size (columns, rows).
    pub(super) fn read(
        inputs: &[TensorInfo],
        outputs: &[TensorInfo],
        metadata: impl Fn(&str) -> Option<String>,
        camera: (usize, usize),
    ) -> Result<Self, NetworkError> {
        let (picture, second) = picture_and_second(inputs)?;
        let joined = second.is_none() && picture.size(1, 3) == 6;
        let mut input_ports =
            vec![check_tensor("input", picture, &[if joined { 6 } else { 3 }], camera)?];
        let input = match second {
            None if joined => InputKind::RgbCoarseJoined,
            None => InputKind::Rgb,
            Some(volume) if is_volume(volume, &metadata) => {
                let port = check_volume(volume, camera)?;
                let planes = port.shape[1];
                input_ports.push(port);
                let keys = ["volume_min_depth_m", "volume_max_depth_m"];
                InputKind::RgbAndVolume {
                    planes,
                    range_m: depth_range(&metadata, keys, VOLUME_RANGE_M)?,
                }
            }
            Some(coarse) => {
                input_ports.push(check_tensor("input", coarse, &[3], camera)?);
                InputKind::RgbAndCoarse
            }
        };
        let [output] = outputs else {
            return Err(NetworkError::Outputs { found: list(outputs), needed: ONE_OUTPUT });
        };
        let output_port = check_tensor("output", output, &[1, 2], camera)?;
        check_kind(&metadata, input)?;
        check_stated_size(&metadata, camera)?;
        Ok(Self {
            input,
            output: output_kind(&metadata, &output.name)?,
            uncertainty: output_port.shape[1] == 2,
            depth_range_m: depth_range(
                &metadata,
                ["min_depth_m", "max_depth_m"],
                DEFAULT_DEPTH_RANGE_M,
            )?,
            size: camera,
            version: metadata("version"),
            input_ports,
            output_port,
        })
    }
}

/// What accompanies the picture is the input whose name says so, else the second.
fn picture_and_second(
    inputs: &[TensorInfo],
) -> Result<(&TensorInfo, Option<&TensorInfo>), NetworkError> {
    let is_second = |tensor: &TensorInfo| {
        let name = tensor.name.to_ascii_lowercase();
        name.contains("coarse") || name.contains("volume")
    };
    match inputs {
        [picture] => Ok((picture, None)),
        [second, picture] if is_second(second) => Ok((picture, Some(second))),
        [picture, second] => Ok((picture, Some(second))),
        _ => Err(NetworkError::Inputs { found: list(inputs), needed: INPUTS }),
    }
}

fn is_volume(second: &TensorInfo, metadata: &impl Fn(&str) -> Option<String>) -> bool {
    metadata("kind").as_deref() == Some("rgb+volume")
        || second.name.to_ascii_lowercase().contains("volume")
}

pub(super) fn list(tensors: &[TensorInfo]) -> String {
    let texts: Vec<_> = tensors.iter().map(TensorInfo::text).collect();
    format!("{} tensors: {}", tensors.len(), texts.join(", "))
}

/// Four dimensions of floats: one picture, one of `channels`, the camera's size.
pub(super) fn check_tensor(
    role: &'static str,
    tensor: &TensorInfo,
    channels: &[i64],
    (width, height): (usize, usize),
) -> Result<Port, NetworkError> {
    let found_channels = tensor.size(1, channels[0]);
    let fits =
        tensor.shape.len() == 4 && tensor.size(0, 1) == 1 && channels.contains(&found_channels);
    let (Some(float), true) = (tensor.float, fits) else {
        let channels: Vec<_> = channels.iter().map(i64::to_string).collect();
        let needed = format!(
            "Tensor<f32>(1, {}, {height}, {width}), or the same of f16",
            channels.join(" or ")
        );
        return Err(NetworkError::Tensor { role, found: tensor.text(), needed });
    };
    let found = (tensor.size(3, width as i64) as usize, tensor.size(2, height as i64) as usize);
    if found != (width, height) {
        return Err(size_error(found, (width, height)));
    }
    Ok(Port {
        name: tensor.name.clone(),
        float,
        shape: [1, found_channels as usize, height, width],
    })
}

/// A fixed number of planes, a quarter of the camera's size.
fn check_volume(
    tensor: &TensorInfo,
    (width, height): (usize, usize),
) -> Result<Port, NetworkError> {
    let (rows, columns) = (height / REDUCTION, width / REDUCTION);
    let planes = tensor.size(1, 0) as usize;
    let whole = width % REDUCTION == 0 && height % REDUCTION == 0 && rows > 1 && columns > 1;
    let size = (tensor.size(2, rows as i64) as usize, tensor.size(3, columns as i64) as usize);
    let fits = tensor.shape.len() == 4 && tensor.size(0, 1) == 1 && size == (rows, columns);
    match tensor.float {
        Some(float) if whole && fits && (2..=MAX_PLANES).contains(&planes) => {
            Ok(Port { name: tensor.name.clone(), float, shape: [1, planes, rows, columns] })
        }
        _ => {
            let needed = format!(
                "Tensor<f32>(1, 2 to {MAX_PLANES}, {rows}, {columns}), or the same of f16, a quarter of a camera whose \
                 width and height are multiples of {REDUCTION}, at least {}; the camera gives {width}x{height}",
                2 * REDUCTION
            );
            Err(NetworkError::Tensor { role: "cost volume", found: tensor.text(), needed })
        }
    }
}

fn size_error(model: (usize, usize), camera: (usize, usize)) -> NetworkError {
    NetworkError::Size {
        model: format!("{}x{}", model.0, model.1),
        camera: format!("{}x{}", camera.0, camera.1),
    }
}

fn check_kind(
    metadata: &impl Fn(&str) -> Option<String>,
    input: InputKind,
) -> Result<(), NetworkError> {
    let shown = input.name();
    match metadata("kind") {
        Some(value) if value != shown => {
            let allowed = format!("`{shown}`, which is what its inputs show");
            Err(NetworkError::Metadata { key: "kind", value, allowed })
        }
        _ => Ok(()),
    }
}

pub(super) fn check_stated_size(
    metadata: &impl Fn(&str) -> Option<String>,
    camera: (usize, usize),
) -> Result<(), NetworkError> {
    let stated = |key, default| {
        number::<usize>(metadata, key, "a whole number of pixels").map(|n| n.unwrap_or(default))
    };
    let size = (stated("input_width", camera.0)?, stated("input_height", camera.1)?);
    if size == camera { Ok(()) } else { Err(size_error(size, camera)) }
}

fn output_kind(
    metadata: &impl Fn(&str) -> Option<String>,
    name: &str,
) -> Result<OutputKind, NetworkError> {
    let allowed = || "`depth`, `disparity`".to_owned();
    match metadata("output").as_deref() {
        Some("depth") => Ok(OutputKind::Depth),
        Some("disparity") => Ok(OutputKind::Disparity),
        Some(value) => Err(NetworkError::Metadata {
            key: "output",
            value: value.to_owned(),
            allowed: allowed(),
        }),
        None if name.contains("depth") => Ok(OutputKind::Depth),
        None if name.contains("disp") => Ok(OutputKind::Disparity),
        None => Err(NetworkError::OutputMeaning { name: name.to_owned() }),
    }
}

fn depth_range(
    metadata: &impl Fn(&str) -> Option<String>,
    [min_key, max_key]: [&'static str; 2],
    default: (f32, f32),
) -> Result<(f32, f32), NetworkError> {
    let metres = "a number of metres";
    let min = number::<f32>(metadata, min_key, metres)?.unwrap_or(default.0);
    let max = number::<f32>(metadata, max_key, metres)?.unwrap_or(default.1);
    if !(min.is_finite() && min > 0.0) {
        let allowed = "a number of metres above 0".to_owned();
        return Err(NetworkError::Metadata { key: min_key, value: min.to_string(), allowed });
    }
    if !(max > min && max <= LARGEST_DEPTH_M) {
        let allowed = format!("above {min_key} = {min}, up to {LARGEST_DEPTH_M} metres");
        return Err(NetworkError::Metadata { key: max_key, value: max.to_string(), allowed });
    }
    Ok((min, max))
}

fn number<T: std::str::FromStr>(
    metadata: &impl Fn(&str) -> Option<String>,
    key: &'static str,
    allowed: &str,
) -> Result<Option<T>, NetworkError> {
    let Some(value) = metadata(key) else { return Ok(None) };
    match value.trim().parse() {
        Ok(number) => Ok(Some(number)),
        Err(_) => Err(NetworkError::Metadata { key, value, allowed: allowed.to_owned() }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::network::bound::Float;

    const CAMERA: (usize, usize) = (640, 192);

    fn tensor(name: &str, channels: i64) -> TensorInfo {
        TensorInfo {
            name: name.to_owned(),
            float: Some(Float::Single),
            shape: vec![1, channels, 192, 640],
            description: String::new(),
        }
    }

    fn read(
        inputs: &[TensorInfo],
        output: TensorInfo,
        metadata: &[(&str, &str)],
    ) -> Result<ModelSpec, NetworkError> {
        let lookup = |key: &str| {
            metadata.iter().find(|(k, _)| *k == key).map(|(_, value)| (*value).to_owned())
        };
        ModelSpec::read(inputs, &[output], lookup, CAMERA)
    }

    #[test]
    fn without_metadata_names_and_shapes_decide() {
        let spec = read(&[tensor("rgb", 3)], tensor("disp_0", 1), &[]).unwrap();
        assert_eq!(
            (spec.input, spec.output, spec.uncertainty),
            (InputKind::Rgb, OutputKind::Disparity, false)
        );
        assert_eq!((spec.depth_range_m, spec.size), (DEFAULT_DEPTH_RANGE_M, CAMERA));
        let spec = read(&[tensor("x", 6)], tensor("depth", 2), &[]).unwrap();
        assert_eq!(
            (spec.input, spec.output, spec.uncertainty),
            (InputKind::RgbCoarseJoined, OutputKind::Depth, true)
        );
    }

    #[test]
    fn the_coarse_input_is_known_by_its_name_and_else_comes_second() {
        let names = |a, b| {
            let spec = read(&[tensor(a, 3), tensor(b, 3)], tensor("depth", 1), &[]).unwrap();
            spec.input_ports.into_iter().map(|port| port.name).collect::<Vec<_>>()
        };
        assert_eq!(names("Coarse", "image"), ["image", "Coarse"]);
        assert_eq!(names("a", "b"), ["a", "b"]);
    }

    #[test]
    fn metadata_overrules_the_name_of_the_output() {
        let spec =
            read(&[tensor("rgb", 3)], tensor("depth", 1), &[("output", "disparity")]).unwrap();
        assert_eq!(spec.output, OutputKind::Disparity);
    }

    #[test]
    fn metadata_that_contradicts_the_inputs_is_refused() {
        let error =
            read(&[tensor("rgb", 3)], tensor("depth", 1), &[("kind", "rgb+coarse")]).unwrap_err();
        assert!(matches!(error, NetworkError::Metadata { key: "kind", .. }), "{error}");
    }

    fn volume(name: &str, planes: i64) -> TensorInfo {
        TensorInfo { shape: vec![1, planes, 48, 160], ..tensor(name, 3) }
    }

    #[test]
    fn a_volume_is_known_by_its_name_or_by_the_kind() {
        let depth = || tensor("depth", 1);
        let range_m = (0.3, 20.0);
        let spec = read(&[tensor("rgb", 3), volume("cost_volume", 32)], depth(), &[]).unwrap();
        assert_eq!(spec.input, InputKind::RgbAndVolume { planes: 32, range_m });
        assert_eq!(spec.input_ports[1].shape, [1, 32, 48, 160]);
        let kind = ("kind", "rgb+volume");
        let spec = read(
            &[tensor("rgb", 3), volume("x", 64)],
            depth(),
            &[kind, ("volume_max_depth_m", "10")],
        )
        .unwrap();
        assert_eq!(spec.input, InputKind::RgbAndVolume { planes: 64, range_m: (0.3, 10.0) });
        let error =
            read(&[tensor("rgb", 3), volume("volume", 32)], depth(), &[("kind", "rgb+coarse")])
                .unwrap_err();
        assert!(matches!(error, NetworkError::Metadata { key: "kind", .. }), "{error}");
    }

    #[test]
    fn a_volume_of_another_size_or_with_an_open_number_of_planes_is_refused() {
        for shape in
            [vec![1, -1, 48, 160], vec![1, 1, 48, 160], vec![1, 32, 192, 640], vec![1, 32, 48]]
        {
            let volume = TensorInfo { shape, ..volume("volume", 32) };
            let error = read(&[tensor("rgb", 3), volume], tensor("depth", 1), &[]).unwrap_err();
            assert!(matches!(error, NetworkError::Tensor { role: "cost volume", .. }), "{error}");
        }
        let error = read(
            &[tensor("rgb", 3), volume("volume", 32)],
            tensor("depth", 1),
            &[("volume_min_depth_m", "-1")],
        );
        assert!(matches!(error, Err(NetworkError::Metadata { key: "volume_min_depth_m", .. })));
    }

    #[test]
    fn depth_ranges_that_cannot_be_are_refused_with_the_key() {
        let key = |metadata: &[(&str, &str)]| match read(
            &[tensor("rgb", 3)],
            tensor("depth", 1),
            metadata,
        ) {
            Err(NetworkError::Metadata { key, .. }) => key,
            other => panic!("{other:?}"),
        };
        assert_eq!(key(&[("min_depth_m", "0")]), "min_depth_m");
        assert_eq!(key(&[("min_depth_m", "NaN")]), "min_depth_m");
        assert_eq!(key(&[("min_depth_m", "near")]), "min_depth_m");
        assert_eq!(key(&[("max_depth_m", "0.05")]), "max_depth_m");
        assert_eq!(key(&[("max_depth_m", "NaN")]), "max_depth_m");
        assert_eq!(key(&[("max_depth_m", "20000")]), "max_depth_m");
    }

    #[test]
    fn a_model_for_another_size_is_told_both_sizes() {
        let mut small = tensor("rgb", 3);
        small.shape = vec![1, 3, 96, 320];
        let text = read(&[small], tensor("depth", 1), &[]).unwrap_err().to_string();
        assert!(text.contains("320x96") && text.contains("640x192"), "{text}");
        let error =
            read(&[tensor("rgb", 3)], tensor("depth", 1), &[("input_width", "320")]).unwrap_err();
        assert!(matches!(error, NetworkError::Size { .. }), "{error}");
    }

    #[test]
    fn open_sizes_take_the_cameras() {
        let open = |name, channels| TensorInfo {
            shape: vec![-1, channels, -1, -1],
            ..tensor(name, channels)
        };
        assert!(read(&[open("rgb", 3)], open("depth", -1), &[]).is_ok());
        let two_pictures = TensorInfo { shape: vec![2, 3, 192, 640], ..tensor("rgb", 3) };
        assert!(read(&[two_pictures], tensor("depth", 1), &[]).is_err());
    }
}
