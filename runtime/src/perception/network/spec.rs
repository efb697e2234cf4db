//! What a model takes and gives, read from its inputs, outputs and metadata, and checked before anything runs.

use super::NetworkError;

/// Depth range of a model that does not name one, metres: the sensor range of Embodied Depth Prediction (Liu et al.).
pub const DEFAULT_DEPTH_RANGE_M: (f32, f32) = (0.1, 20.0);
/// No indoor or street scene is deeper; a larger number in a model is a mistake of units.
const LARGEST_DEPTH_M: f32 = 1000.0;

/// How the picture and the coarse depth enter the model. All values are `f32`, planes in rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InputKind {
    /// Red, green, blue in 0..1: `[1, 3, height, width]`.
    Rgb,
    /// As `Rgb`, and a second input with coarse disparity, validity and confidence in 0..1: `[1, 3, height, width]`.
    RgbAndCoarse,
    /// Both in one input: `[1, 6, height, width]`.
    RgbCoarseJoined,
}

impl InputKind {
    /// Whether the model uses the coarse depth.
    #[must_use]
    pub fn takes_coarse(self) -> bool {
        self != Self::Rgb
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

/// A tensor as the model describes it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TensorInfo {
    pub name: String,
    /// Whether the elements are 32-bit floats.
    pub is_f32: bool,
    /// Sizes; -1 where the model leaves one open.
    pub shape: Vec<i64>,
    /// Type and shape in words.
    pub description: String,
}

impl TensorInfo {
    fn text(&self) -> String {
        format!("`{}` {}", self.name, self.description)
    }

    /// Size of one dimension, `wanted` where the model leaves it open.
    fn size(&self, dimension: usize, wanted: i64) -> i64 {
        self.shape.get(dimension).copied().filter(|size| *size >= 0).unwrap_or(wanted)
    }
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
    /// Name of the input with the picture, and of the one with the coarse depth where that is another.
    pub(super) input_names: (String, Option<String>),
    pub(super) output_name: String,
}

impl ModelSpec {
    /// Reads and checks what a model says about itself against the camera's picture size (columns, rows).
    pub(super) fn read(
        inputs: &[TensorInfo],
        outputs: &[TensorInfo],
        metadata: impl Fn(&str) -> Option<String>,
        camera: (usize, usize),
    ) -> Result<Self, NetworkError> {
        let (picture, coarse) = picture_and_coarse(inputs)?;
        let joined = coarse.is_none() && picture.size(1, 3) == 6;
        let input = match (coarse, joined) {
            (Some(_), _) => InputKind::RgbAndCoarse,
            (None, true) => InputKind::RgbCoarseJoined,
            (None, false) => InputKind::Rgb,
        };
        check_tensor("input", picture, &[if joined { 6 } else { 3 }], camera)?;
        if let Some(coarse) = coarse {
            check_tensor("input", coarse, &[3], camera)?;
        }
        let [output] = outputs else { return Err(NetworkError::Outputs { found: list(outputs) }) };
        check_tensor("output", output, &[1, 2], camera)?;
        check_kind(&metadata, input)?;
        check_stated_size(&metadata, camera)?;
        Ok(Self {
            input,
            output: output_kind(&metadata, &output.name)?,
            uncertainty: output.size(1, 1) == 2,
            depth_range_m: depth_range(&metadata)?,
            size: camera,
            version: metadata("version"),
            input_names: (picture.name.clone(), coarse.map(|coarse| coarse.name.clone())),
            output_name: output.name.clone(),
        })
    }

    /// Channels of the input that carries the picture.
    pub(super) fn picture_channels(&self) -> usize {
        if self.input == InputKind::RgbCoarseJoined { 6 } else { 3 }
    }

    /// Channels of the output.
    pub(super) fn output_channels(&self) -> usize {
        if self.uncertainty { 2 } else { 1 }
    }
}

/// The coarse depth is the input whose name says so, else the second.
fn picture_and_coarse(inputs: &[TensorInfo]) -> Result<(&TensorInfo, Option<&TensorInfo>), NetworkError> {
    match inputs {
        [picture] => Ok((picture, None)),
        [coarse, picture] if coarse.name.to_ascii_lowercase().contains("coarse") => Ok((picture, Some(coarse))),
        [picture, coarse] => Ok((picture, Some(coarse))),
        _ => Err(NetworkError::Inputs { found: list(inputs) }),
    }
}

fn list(tensors: &[TensorInfo]) -> String {
    let texts: Vec<_> = tensors.iter().map(TensorInfo::text).collect();
    format!("{} tensors: {}", tensors.len(), texts.join(", "))
}

/// Four dimensions of 32-bit floats: one picture, one of `channels`, the camera's size.
fn check_tensor(
    role: &'static str,
    tensor: &TensorInfo,
    channels: &[i64],
    (width, height): (usize, usize),
) -> Result<(), NetworkError> {
    let found_channels = tensor.size(1, channels[0]);
    if !tensor.is_f32 || tensor.shape.len() != 4 || tensor.size(0, 1) != 1 || !channels.contains(&found_channels) {
        let channels: Vec<_> = channels.iter().map(i64::to_string).collect();
        let needed = format!("Tensor<f32>(1, {}, {height}, {width})", channels.join(" or "));
        return Err(NetworkError::Tensor { role, found: tensor.text(), needed });
    }
    let found = (tensor.size(3, width as i64) as usize, tensor.size(2, height as i64) as usize);
    if found != (width, height) {
        return Err(size_error(found, (width, height)));
    }
    Ok(())
}

fn size_error(model: (usize, usize), camera: (usize, usize)) -> NetworkError {
    NetworkError::Size { model: format!("{}x{}", model.0, model.1), camera: format!("{}x{}", camera.0, camera.1) }
}

fn check_kind(metadata: &impl Fn(&str) -> Option<String>, input: InputKind) -> Result<(), NetworkError> {
    let shown = if input.takes_coarse() { "rgb+coarse" } else { "rgb" };
    match metadata("kind") {
        Some(value) if value != shown => {
            let allowed = format!("`{shown}`, which is what its inputs show");
            Err(NetworkError::Metadata { key: "kind", value, allowed })
        }
        _ => Ok(()),
    }
}

fn check_stated_size(metadata: &impl Fn(&str) -> Option<String>, camera: (usize, usize)) -> Result<(), NetworkError> {
    let stated =
        |key, default| number::<usize>(metadata, key, "a whole number of pixels").map(|n| n.unwrap_or(default));
    let size = (stated("input_width", camera.0)?, stated("input_height", camera.1)?);
    if size == camera { Ok(()) } else { Err(size_error(size, camera)) }
}

fn output_kind(metadata: &impl Fn(&str) -> Option<String>, name: &str) -> Result<OutputKind, NetworkError> {
    let allowed = || "`depth`, `disparity`".to_owned();
    match metadata("output").as_deref() {
        Some("depth") => Ok(OutputKind::Depth),
        Some("disparity") => Ok(OutputKind::Disparity),
        Some(value) => Err(NetworkError::Metadata { key: "output", value: value.to_owned(), allowed: allowed() }),
        None if name.contains("depth") => Ok(OutputKind::Depth),
        None if name.contains("disp") => Ok(OutputKind::Disparity),
        None => Err(NetworkError::OutputMeaning { name: name.to_owned() }),
    }
}

fn depth_range(metadata: &impl Fn(&str) -> Option<String>) -> Result<(f32, f32), NetworkError> {
    let metres = "a number of metres";
    let min = number::<f32>(metadata, "min_depth_m", metres)?.unwrap_or(DEFAULT_DEPTH_RANGE_M.0);
    let max = number::<f32>(metadata, "max_depth_m", metres)?.unwrap_or(DEFAULT_DEPTH_RANGE_M.1);
    if !(min.is_finite() && min > 0.0) {
        let allowed = "a number of metres above 0".to_owned();
        return Err(NetworkError::Metadata { key: "min_depth_m", value: min.to_string(), allowed });
    }
    if !(max > min && max <= LARGEST_DEPTH_M) {
        let allowed = format!("above min_depth_m = {min}, up to {LARGEST_DEPTH_M} metres");
        return Err(NetworkError::Metadata { key: "max_depth_m", value: max.to_string(), allowed });
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

    const CAMERA: (usize, usize) = (640, 192);

    fn tensor(name: &str, channels: i64) -> TensorInfo {
        TensorInfo {
            name: name.to_owned(),
            is_f32: true,
            shape: vec![1, channels, 192, 640],
            description: String::new(),
        }
    }

    fn read(inputs: &[TensorInfo], output: TensorInfo, metadata: &[(&str, &str)]) -> Result<ModelSpec, NetworkError> {
        let lookup = |key: &str| metadata.iter().find(|(k, _)| *k == key).map(|(_, value)| (*value).to_owned());
        ModelSpec::read(inputs, &[output], lookup, CAMERA)
    }

    #[test]
    fn without_metadata_names_and_shapes_decide() {
        let spec = read(&[tensor("rgb", 3)], tensor("disp_0", 1), &[]).unwrap();
        assert_eq!((spec.input, spec.output, spec.uncertainty), (InputKind::Rgb, OutputKind::Disparity, false));
        assert_eq!((spec.depth_range_m, spec.size), (DEFAULT_DEPTH_RANGE_M, CAMERA));
        let spec = read(&[tensor("x", 6)], tensor("depth", 2), &[]).unwrap();
        assert_eq!((spec.input, spec.output, spec.uncertainty), (InputKind::RgbCoarseJoined, OutputKind::Depth, true));
    }

    #[test]
    fn the_coarse_input_is_known_by_its_name_and_else_comes_second() {
        let names = |a, b| read(&[tensor(a, 3), tensor(b, 3)], tensor("depth", 1), &[]).unwrap().input_names;
        assert_eq!(names("Coarse", "image"), ("image".to_owned(), Some("Coarse".to_owned())));
        assert_eq!(names("a", "b"), ("a".to_owned(), Some("b".to_owned())));
    }

    #[test]
    fn metadata_overrules_the_name_of_the_output() {
        let spec = read(&[tensor("rgb", 3)], tensor("depth", 1), &[("output", "disparity")]).unwrap();
        assert_eq!(spec.output, OutputKind::Disparity);
    }

    #[test]
    fn metadata_that_contradicts_the_inputs_is_refused() {
        let error = read(&[tensor("rgb", 3)], tensor("depth", 1), &[("kind", "rgb+coarse")]).unwrap_err();
        assert!(matches!(error, NetworkError::Metadata { key: "kind", .. }), "{error}");
    }

    #[test]
    fn depth_ranges_that_cannot_be_are_refused_with_the_key() {
        let key = |metadata: &[(&str, &str)]| match read(&[tensor("rgb", 3)], tensor("depth", 1), metadata) {
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
        let error = read(&[tensor("rgb", 3)], tensor("depth", 1), &[("input_width", "320")]).unwrap_err();
        assert!(matches!(error, NetworkError::Size { .. }), "{error}");
    }

    #[test]
    fn open_sizes_take_the_cameras() {
        let open = |name, channels| TensorInfo { shape: vec![-1, channels, -1, -1], ..tensor(name, channels) };
        assert!(read(&[open("rgb", 3)], open("depth", -1), &[]).is_ok());
        let two_pictures = TensorInfo { shape: vec![2, 3, 192, 640], ..tensor("rgb", 3) };
        assert!(read(&[two_pictures], tensor("depth", 1), &[]).is_err());
    }
}
