//! A model's inputs and output, read from its tensors and metadata and checked before it runs.

use super::NetworkError;
use super::bound::{Port, TensorInfo};
use super::volume::REDUCTION;

/// Depth range of a model that does not name one, metres: the sensor range of Embodied Depth Prediction (Liu et al.).
pub const DEFAULT_DEPTH_RANGE_M: (f32, f32) = (0.1, 20.0);
/// No indoor or street scene is deeper; a larger number in a model has the wrong unit.
const LARGEST_DEPTH_M: f32 = 1000.0;
/// Depth range of a cost volume whose model does not name one, metres.
const VOLUME_RANGE_M: (f32, f32) = (0.3, 20.0);
/// ManyDepth has 96; with more planes than this, the tensor's layout is wrong.
const MAX_PLANES: usize = 256;

const INPUTS: &str = "one image [1, 3, height, width], alone or with a second input: coarse disparity, validity and \
    confidence [1, 3, height, width] (or joined with the image in [1, 6, height, width]), or a cost volume \
    [1, planes, height / 4, width / 4]";
const ONE_OUTPUT: &str = "one output, [1, 1, height, width], or [1, 2, height, width] with log-uncertainty; export only the finest scale";

/// The inputs of a model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum InputKind {
    /// Red, green, blue in 0..1: `[1, 3, height, width]`.
    Rgb,
    /// Like `Rgb`, with a second input of coarse disparity, validity and confidence in 0..1: `[1, 3, height, width]`.
    RgbAndCoarse,
    /// The image and the coarse planes in one input: `[1, 6, height, width]`.
    RgbCoarseJoined,
    /// Like `Rgb`, with the cost volume as a second input: `[1, planes, height / 4, width / 4]`.
    RgbAndVolume {
        /// Number of planes, evenly spaced in inverse depth.
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

    /// Its name in the metadata.
    fn name(self) -> &'static str {
        match self {
            Self::Rgb => "rgb",
            Self::RgbAndCoarse | Self::RgbCoarseJoined => "rgb+coarse",
            Self::RgbAndVolume { .. } => "rgb+volume",
        }
    }
}

/// The depth that a model with a coarse input is given (metadata `given_depth`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GivenDepth {
    /// Coarse depth, which has holes.
    Coarse,
    /// Dense depth: coarse depth, completed without a network.
    Dense,
}

/// The meaning of the first channel of the output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutputKind {
    /// The channel is z-depth in metres.
    Depth,
    /// The channel is x in 0..1 with disparity = 1/max + (1/min - 1/max) x and depth = 1/disparity (Godard et al. 2019,
    /// Monodepth2, section 3).
    Disparity,
}

/// Inputs, output and metadata of a model.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelSpec {
    pub input: InputKind,
    /// The depth that the coarse input takes; without such an input it has no effect.
    pub given: GivenDepth,
    pub output: OutputKind,
    /// Whether a second output channel holds ln b, where b is the Laplace scale of the error of ln depth.
    pub uncertainty: bool,
    /// Smallest and largest depth of the output, metres.
    pub depth_range_m: (f32, f32),
    /// Columns and rows of the image.
    pub size: (usize, usize),
    /// Name and version of the model (metadata `version`).
    pub version: Option<String>,
    /// The image first, then the second input.
    pub(super) input_ports: Vec<Port>,
    pub(super) output_port: Port,
}

impl ModelSpec {
    /// Reads a model's description and checks it against the camera's image size (columns, rows).
    pub(super) fn read(
        inputs: &[TensorInfo],
        outputs: &[TensorInfo],
        metadata: impl Fn(&str) -> Option<String>,
        camera: (usize, usize),
    ) -> Result<Self, NetworkError> {
        let (image, second) = image_and_second(inputs)?;
        let joined = second.is_none() && image.size(1, 3) == 6;
        let mut input_ports =
            vec![check_tensor("input", image, &[if joined { 6 } else { 3 }], camera)?];
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
            given: given_depth(&metadata)?,
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

/// The image and the second input: the input with `coarse` or `volume` in its name, else the second one.
fn image_and_second(
    inputs: &[TensorInfo],
) -> Result<(&TensorInfo, Option<&TensorInfo>), NetworkError> {
    match inputs {
        [image] => Ok((image, None)),
        [second, image] if is_second(second) => Ok((image, Some(second))),
        [image, second] => Ok((image, Some(second))),
        _ => Err(NetworkError::Inputs { found: list(inputs), needed: INPUTS }),
    }
}

/// Whether a tensor's name marks it as the second input.
fn is_second(tensor: &TensorInfo) -> bool {
    let name = tensor.name.to_ascii_lowercase();
    name.contains("coarse") || name.contains("volume")
}

fn is_volume(second: &TensorInfo, metadata: &impl Fn(&str) -> Option<String>) -> bool {
    metadata("kind").as_deref() == Some("rgb+volume")
        || second.name.to_ascii_lowercase().contains("volume")
}

fn list(tensors: &[TensorInfo]) -> String {
    let texts: Vec<_> = tensors.iter().map(TensorInfo::text).collect();
    format!("{} tensors: {}", tensors.len(), texts.join(", "))
}

/// Checks for a float tensor `[1, one of channels, height, width]`.
fn check_tensor(
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

/// Checks for a float tensor `[1, planes, height / 4, width / 4]` with a fixed number of planes.
fn check_volume(
    tensor: &TensorInfo,
    (width, height): (usize, usize),
) -> Result<Port, NetworkError> {
    let rows = height / REDUCTION;
    let columns = width / REDUCTION;
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

fn given_depth(metadata: &impl Fn(&str) -> Option<String>) -> Result<GivenDepth, NetworkError> {
    match metadata("given_depth").as_deref() {
        None | Some("coarse") => Ok(GivenDepth::Coarse),
        Some("dense") => Ok(GivenDepth::Dense),
        Some(value) => Err(NetworkError::Metadata {
            key: "given_depth",
            value: value.to_owned(),
            allowed: "`coarse`, `dense`".to_owned(),
        }),
    }
}

fn check_stated_size(
    metadata: &impl Fn(&str) -> Option<String>,
    camera: (usize, usize),
) -> Result<(), NetworkError> {
    let pixels = "a whole number of pixels";
    let width = number::<usize>(metadata, "input_width", pixels)?.unwrap_or(camera.0);
    let height = number::<usize>(metadata, "input_height", pixels)?.unwrap_or(camera.1);
    let size = (width, height);
    if size == camera { Ok(()) } else { Err(size_error(size, camera)) }
}

fn output_kind(
    metadata: &impl Fn(&str) -> Option<String>,
    name: &str,
) -> Result<OutputKind, NetworkError> {
    match metadata("output").as_deref() {
        Some("depth") => Ok(OutputKind::Depth),
        Some("disparity") => Ok(OutputKind::Disparity),
        Some(value) => Err(NetworkError::Metadata {
            key: "output",
            value: value.to_owned(),
            allowed: "`depth`, `disparity`".to_owned(),
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
        ModelSpec::read(
            inputs,
            &[output],
            |key| metadata.iter().find(|(k, _)| *k == key).map(|(_, value)| (*value).to_owned()),
            CAMERA,
        )
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
    fn a_model_is_given_coarse_depth_unless_it_asks_for_dense_depth() {
        assert_eq!(given(&[]), Ok(GivenDepth::Coarse));
        assert_eq!(given(&[("given_depth", "coarse")]), Ok(GivenDepth::Coarse));
        assert_eq!(given(&[("given_depth", "dense")]), Ok(GivenDepth::Dense));
        let error = given(&[("given_depth", "sparse")]).unwrap_err();
        assert!(matches!(error, NetworkError::Metadata { key: "given_depth", .. }), "{error}");
    }

    fn given(metadata: &[(&str, &str)]) -> Result<GivenDepth, NetworkError> {
        read(&[tensor("rgb", 3), tensor("coarse", 3)], tensor("depth", 1), metadata)
            .map(|spec| spec.given)
    }

    #[test]
    fn the_coarse_input_is_recognised_by_its_name_and_else_comes_second() {
        for (names, expected) in
            [(["Coarse", "image"], ["image", "Coarse"]), (["a", "b"], ["a", "b"])]
        {
            let inputs = names.map(|name| tensor(name, 3));
            let spec = read(&inputs, tensor("depth", 1), &[]).unwrap();
            let ports: Vec<_> = spec.input_ports.into_iter().map(|port| port.name).collect();
            assert_eq!(ports, expected);
        }
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
    fn a_volume_is_recognised_by_its_name_or_by_the_kind() {
        let depth = tensor("depth", 1);
        let range_m = (0.3, 20.0);
        let spec =
            read(&[tensor("rgb", 3), volume("cost_volume", 32)], depth.clone(), &[]).unwrap();
        assert_eq!(spec.input, InputKind::RgbAndVolume { planes: 32, range_m });
        assert_eq!(spec.input_ports[1].shape, [1, 32, 48, 160]);
        let kind = ("kind", "rgb+volume");
        let spec = read(
            &[tensor("rgb", 3), volume("x", 64)],
            depth.clone(),
            &[kind, ("volume_max_depth_m", "10")],
        )
        .unwrap();
        assert_eq!(spec.input, InputKind::RgbAndVolume { planes: 64, range_m: (0.3, 10.0) });
        let error =
            read(&[tensor("rgb", 3), volume("volume", 32)], depth, &[("kind", "rgb+coarse")])
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
    fn impossible_depth_ranges_are_refused_with_the_key() {
        for (name, value) in [
            ("min_depth_m", "0"),
            ("min_depth_m", "NaN"),
            ("min_depth_m", "near"),
            ("max_depth_m", "0.05"),
            ("max_depth_m", "NaN"),
            ("max_depth_m", "20000"),
        ] {
            match read(&[tensor("rgb", 3)], tensor("depth", 1), &[(name, value)]) {
                Err(NetworkError::Metadata { key, .. }) => assert_eq!(key, name),
                other => panic!("{name} = {value}: {other:?}"),
            }
        }
    }

    #[test]
    fn a_model_for_another_size_is_refused_with_both_sizes() {
        let mut small = tensor("rgb", 3);
        small.shape = vec![1, 3, 96, 320];
        let text = read(&[small], tensor("depth", 1), &[]).unwrap_err().to_string();
        assert!(text.contains("320x96") && text.contains("640x192"), "{text}");
        let error =
            read(&[tensor("rgb", 3)], tensor("depth", 1), &[("input_width", "320")]).unwrap_err();
        assert!(matches!(error, NetworkError::Size { .. }), "{error}");
    }

    #[test]
    fn dynamic_sizes_take_the_cameras() {
        let rgb = TensorInfo { shape: vec![-1, 3, -1, -1], ..tensor("rgb", 3) };
        let depth = TensorInfo { shape: vec![-1, -1, -1, -1], ..tensor("depth", -1) };
        assert!(read(&[rgb], depth, &[]).is_ok());
        let two_images = TensorInfo { shape: vec![2, 3, 192, 640], ..tensor("rgb", 3) };
        assert!(read(&[two_images], tensor("depth", 1), &[]).is_err());
    }
}
