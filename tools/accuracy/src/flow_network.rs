//! Optical flow from a network: any ONNX model with two images as inputs and the flow from one to the other as output.

use anyhow::{Context, Result, bail, ensure};
use hal::{ImageView, PixelFormat};
use ort::environment::Environment;
use ort::session::{Session, SessionInputValue};
use ort::value::{Outlet, Tensor, TensorElementType};
use runtime::perception::flow::FlowField;

/// Metadata of a model; each key is optional.
///
/// | key | value | without it |
/// |---|---|---|
/// | `kind` | `flow` | not checked |
/// | `from` | name of the input whose pixels the flow starts from | the first input |
/// | `input_range` | black and white as `0..1`, `-1..1` or `0..255` | `0..1` |
/// | `input_width`, `input_height` | size of the images | not checked |
struct Metadata<'a>(ort::session::ModelMetadata<'a>);

/// A loaded flow model for images of one size.
#[derive(Debug)]
pub struct FlowNetwork {
    session: Session,
    /// Whether the flow starts from the model's second input.
    from_second: bool,
    /// Black and white as the model expects them.
    input_range: (f32, f32),
    size: (usize, usize),
    flow: FlowField,
}

impl FlowNetwork {
    /// Loads a model from the bytes of its file, for images of `size` (columns, rows), and runs it once on grey images.
    ///
    /// # Errors
    /// When ONNX Runtime cannot load the model, or the model is not a flow network for such images.
    pub fn load(
        onnx_runtime: &Environment,
        model: &[u8],
        size: (usize, usize),
        threads: usize,
    ) -> Result<Self> {
        let session = session(onnx_runtime, model, threads)?;
        let inputs = session.inputs();
        let outputs = session.outputs();
        let [first, second] = inputs else {
            bail!(
                "the model has {}, needed: two images, each [1, 3, height, width]",
                describe(inputs)
            );
        };
        let [flow] = outputs else {
            bail!(
                "the model has {}, needed: one flow field [1, 2, height, width] in pixels; export only the last iteration",
                describe(outputs)
            );
        };
        check_tensor(first, 3, size)?;
        check_tensor(second, 3, size)?;
        check_tensor(flow, 2, size)?;
        let metadata = Metadata(session.metadata()?);
        metadata.check_kind()?;
        metadata.check_size(size)?;
        let from_second = metadata.starts_from_second(first.name(), second.name())?;
        let input_range = metadata.input_range()?;
        drop(metadata);
        let flow = FlowField::zero(size.0, size.1);
        let mut network = Self { session, from_second, input_range, size, flow };
        let grey = vec![127; 3 * size.0 * size.1];
        let grey = ImageView::rgb8(size.0, size.1, &grey)?;
        network.estimate(grey, grey).context("the model fails on a plain grey image")?;
        Ok(network)
    }

    /// The displacement of every pixel of `from` to `to`, both RGB8. A pixel whose match would be farther away than the image
    /// is large has none (NaN).
    ///
    /// # Errors
    /// Images of another size or format, a failing model, or a flow with NaN or infinity.
    pub fn estimate(&mut self, from: ImageView<'_>, to: ImageView<'_>) -> Result<&FlowField> {
        let (width, height) = self.size;
        for image in [from, to] {
            let fits = (image.width(), image.height()) == self.size;
            ensure!(
                fits && image.format() == PixelFormat::Rgb8,
                "the image is {}x{} {:?}, needed: {width}x{height} RGB8",
                image.width(),
                image.height(),
                image.format()
            );
        }
        let [first, second] = if self.from_second { [to, from] } else { [from, to] };
        let inputs: [SessionInputValue<'_>; 2] =
            [tensor(first, self.input_range)?.into(), tensor(second, self.input_range)?.into()];
        let outputs = self.session.run(inputs.as_slice())?;
        let planes = outputs[0].try_extract_tensor::<f32>()?.1;
        let (xs, ys) = planes
            .split_at_checked(width * height)
            .filter(|(xs, ys)| xs.len() == ys.len())
            .context("the flow has another size")?;
        ensure!(planes.iter().all(|value| value.is_finite()), "its flow is NaN or infinite");
        for ((flow, &x), &y) in self.flow.values_mut().iter_mut().zip(xs).zip(ys) {
            let inside = x.abs() <= width as f32 && y.abs() <= height as f32;
            *flow = if inside { [x, y] } else { [f32::NAN; 2] };
        }
        Ok(&self.flow)
    }
}

fn session(onnx_runtime: &Environment, model: &[u8], threads: usize) -> ort::Result<Session> {
    // By default, threads continue to spin after a run.
    let builder = Session::builder(onnx_runtime)?.with_intra_threads(threads)?;
    builder.with_config_entry("session.force_spinning_stop", "1")?.commit_from_memory(model)
}

fn describe(tensors: &[Outlet]) -> String {
    let names: Vec<_> =
        tensors.iter().map(|tensor| format!("`{}` {}", tensor.name(), tensor.dtype())).collect();
    format!("{} tensors: {}", tensors.len(), names.join(", "))
}

/// Checks for a tensor of 32-bit floats `[1, channels, height, width]`; dynamic dimensions are accepted.
fn check_tensor(tensor: &Outlet, channels: usize, (width, height): (usize, usize)) -> Result<()> {
    let is_float = tensor.dtype().tensor_type() == Some(TensorElementType::Float32);
    let shape = tensor.dtype().tensor_shape().map(|shape| shape.to_vec()).unwrap_or_default();
    let expected = [1, channels as i64, height as i64, width as i64];
    let fits = shape.len() == expected.len()
        && shape.iter().zip(expected).all(|(found, expected)| *found < 0 || *found == expected);
    ensure!(
        is_float && fits,
        "the model's `{}` is {}, needed: Tensor<f32>(1, {channels}, {height}, {width})",
        tensor.name(),
        tensor.dtype()
    );
    Ok(())
}

/// The image as planes of red, green and blue.
fn tensor(image: ImageView<'_>, (low, high): (f32, f32)) -> Result<Tensor<f32>> {
    let data = image.data();
    let bytes = (0..3).flat_map(|channel| data.iter().skip(channel).step_by(3));
    let planes: Vec<f32> =
        bytes.map(|byte| f32::from(*byte) / 255.0 * (high - low) + low).collect();
    Ok(Tensor::from_array(([1, 3, image.height(), image.width()], planes))?)
}

impl Metadata<'_> {
    fn check_kind(&self) -> Result<()> {
        match self.0.custom("kind") {
            Some(kind) if kind != "flow" => {
                bail!("the model's metadata has kind = `{kind}`, allowed: `flow`")
            }
            _ => Ok(()),
        }
    }

    fn check_size(&self, size: (usize, usize)) -> Result<()> {
        for (key, pixels) in [("input_width", size.0), ("input_height", size.1)] {
            let stated = self.0.custom(key);
            ensure!(
                stated.as_ref().is_none_or(|stated| stated.trim().parse() == Ok(pixels)),
                "the model's metadata has {key} = `{}`, the camera delivers {pixels}",
                stated.unwrap_or_default()
            );
        }
        Ok(())
    }

    fn starts_from_second(&self, first: &str, second: &str) -> Result<bool> {
        match self.0.custom("from") {
            Some(from) if from == second => Ok(true),
            Some(from) if from != first => {
                bail!("the model's metadata has from = `{from}`, allowed: `{first}`, `{second}`")
            }
            _ => Ok(false),
        }
    }

    fn input_range(&self) -> Result<(f32, f32)> {
        match self.0.custom("input_range").as_deref() {
            None | Some("0..1") => Ok((0.0, 1.0)),
            Some("-1..1") => Ok((-1.0, 1.0)),
            Some("0..255") => Ok((0.0, 255.0)),
            Some(range) => bail!(
                "the model's metadata has input_range = `{range}`, allowed: `0..1`, `-1..1`, `0..255`"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    const SIZE: (usize, usize) = (8, 4);

    fn load_from(folder: &str, name: &str) -> Result<FlowNetwork> {
        let (onnx_runtime, _) = firmware_host::onnx_runtime::init().unwrap();
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder).join(name);
        let model = std::fs::read(path.with_extension("onnx")).unwrap();
        FlowNetwork::load(&onnx_runtime, &model, SIZE, 1)
    }

    fn load(name: &str) -> Result<FlowNetwork> {
        load_from("tests/models", name)
    }

    fn plain(colour: [u8; 3]) -> Vec<u8> {
        colour.repeat(SIZE.0 * SIZE.1)
    }

    fn view(bytes: &[u8]) -> ImageView<'_> {
        ImageView::rgb8(SIZE.0, SIZE.1, bytes).unwrap()
    }

    /// The flow from a plain image to another, which is the same at every pixel.
    fn flow(name: &str, from: [u8; 3], to: [u8; 3]) -> [f32; 2] {
        let mut network = load(name).unwrap();
        let field = network.estimate(view(&plain(from)), view(&plain(to))).unwrap();
        let first = field.values()[0].map(f32::to_bits);
        assert!(field.values().iter().all(|flow| flow.map(f32::to_bits) == first));
        first.map(f32::from_bits)
    }

    #[test]
    fn flow_is_in_pixels_and_each_image_goes_to_its_own_input() {
        assert_eq!(flow("flow", [0; 3], [0; 3]), [2.5, -1.25]);
        // x is red of the first, y ten times green of the second.
        assert_eq!(flow("flow", [255, 0, 0], [0, 51, 0]), [3.5, 0.75]);
    }

    #[test]
    fn the_metadata_define_the_input_range_and_where_flow_starts() {
        assert_eq!(flow("flow_bytes", [5, 0, 0], [0; 3]), [5.0, 0.0]);
        // The flow starts from the model's second input: red 0 (-1) is in `to`, green 140 (0.098) in `from`.
        let [x, y] = flow("flow_signed_backwards", [0, 140, 0], [0; 3]);
        assert!((x + 1.0).abs() < 1e-4, "{x}");
        assert!((y - 10.0 * (2.0 * 140.0 / 255.0 - 1.0)).abs() < 1e-4, "{y}");
    }

    #[test]
    fn a_match_farther_away_than_the_image_is_large_is_none() {
        assert_eq!(flow("flow_far", [51, 0, 0], [0; 3]), [7.7, 0.0]);
        assert!(flow("flow_far", [255, 0, 0], [0; 3]).iter().all(|flow| flow.is_nan()));
    }

    #[test]
    fn unsuitable_models_are_refused_with_what_is_needed() {
        let depth_models = "../../runtime/tests/models";
        for (folder, name, words) in [
            ("tests/models", "flow_range_unknown", ["input_range = `0..2`", "`-1..1`"]),
            ("tests/models", "flow_from_nowhere", ["from = `left`", "`image1`, `image2`"]),
            ("tests/models", "flow_nan", ["NaN", "grey image"]),
            (depth_models, "mean", ["1 tensors", "two images"]),
            (depth_models, "coarse_second_input", ["kind = `rgb+coarse`", "`flow`"]),
        ] {
            let text = format!("{:#}", load_from(folder, name).expect_err(name));
            assert!(words.iter().all(|word| text.contains(word)), "{name}: {text}");
        }
    }

    #[test]
    fn an_image_of_another_size_is_refused() {
        let mut network = load("flow").unwrap();
        let small = vec![0; 3 * 4 * 4];
        let small = ImageView::rgb8(4, 4, &small).unwrap();
        let error = network.estimate(view(&plain([0; 3])), small).unwrap_err().to_string();
        assert!(error.contains("4x4") && error.contains("8x4"), "{error}");
    }
}
