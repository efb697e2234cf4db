//! What an ONNX file may be before any runtime parses it: one of the opsets that robots run, and nothing outside the file.
//!
//! Reads the few fields of the protobuf that say so (onnx.proto3 of ONNX 1.16; field numbers are part of that format and do not
//! change), steps over the rest, and never allocates by a length in the file.

use std::ops::RangeInclusive;

/// Opsets of `ai.onnx` that are taken: 11 is what the oldest exporters in use write; 21 is run by every ONNX Runtime since 1.20, and
/// a robot needs 1.22. `tools/trainer` writes 17.
pub const OPSETS: RangeInclusive<i64> = 11..=21;
/// Subgraphs in subgraphs; a loop in a loop in a branch has three.
const DEEPEST: usize = 16;

/// Why a file may not be loaded.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum OnnxFault {
    /// Not a protobuf, or cut.
    #[error(
        "the file is no whole ONNX model (it breaks off or is something else at byte {at}); export it again"
    )]
    Broken {
        /// Where, in bytes.
        at: usize,
    },
    /// An opset that not all robots run.
    #[error("the model is of opset {found}, allowed: {} to {}; export it with opset 17", OPSETS.start(), OPSETS.end())]
    Opset {
        /// What it says; 0: nothing.
        found: i64,
    },
    /// Operators that are not ONNX's own.
    #[error("the model needs operators of `{domain}`; export it with ONNX's own operators only")]
    Domain {
        /// Whose.
        domain: String,
    },
    /// Weights in other files.
    #[error(
        "the model keeps the tensor `{tensor}` in another file; export it with all weights inside (one file)"
    )]
    ExternalData {
        /// Which tensor.
        tensor: String,
    },
    /// Deeper than any real network.
    #[error("the model nests graphs more than {DEEPEST} deep; no depth network needs that")]
    TooDeep,
}

/// Checks a model's bytes.
///
/// # Errors
/// The first fault that was found.
pub fn check_onnx_file(bytes: &[u8]) -> Result<(), OnnxFault> {
    let mut opset = 0;
    let mut fields = Fields { bytes, at: 0, base: 0 };
    while let Some(field) = fields.next()? {
        match (field.number, field.value) {
            // ModelProto.opset_import: domain 1, version 2.
            (8, Value::Bytes(inner)) => match opset_import(inner)? {
                (domain, version) if domain.is_empty() || domain == "ai.onnx" => opset = version,
                // What ONNX itself puts beside its operators.
                (domain, _) if domain == "ai.onnx.ml" => {}
                (domain, _) => return Err(OnnxFault::Domain { domain }),
            },
            // ModelProto.graph, and functions 25, whose nodes are field 7.
            (7, Value::Bytes(inner)) => graph(inner, 0)?,
            (25, Value::Bytes(inner)) => nodes(inner, 7, 0)?,
            _ => {}
        }
    }
    if OPSETS.contains(&opset) { Ok(()) } else { Err(OnnxFault::Opset { found: opset }) }
}

fn opset_import(inner: Inner<'_>) -> Result<(String, i64), OnnxFault> {
    let (mut domain, mut version) = (String::new(), 0);
    let mut fields = inner.fields();
    while let Some(field) = fields.next()? {
        match (field.number, field.value) {
            (1, Value::Bytes(text)) => domain = text.text(),
            (2, Value::Number(number)) => version = number as i64,
            _ => {}
        }
    }
    Ok((domain, version))
}

/// GraphProto: node 1, initializer 5, sparse_initializer 15.
fn graph(inner: Inner<'_>, depth: usize) -> Result<(), OnnxFault> {
    if depth > DEEPEST {
        return Err(OnnxFault::TooDeep);
    }
    let mut fields = inner.fields();
    while let Some(field) = fields.next()? {
        match (field.number, field.value) {
            (5, Value::Bytes(inner)) => tensor(inner)?,
            (15, Value::Bytes(inner)) => sparse_tensor(inner)?,
            _ => {}
        }
    }
    nodes(inner, 1, depth)
}

/// NodeProto: attribute 5. AttributeProto: t 5, g 6, tensors 10, graphs 11, sparse_tensor 22, sparse_tensors 23.
fn nodes(inner: Inner<'_>, number: u64, depth: usize) -> Result<(), OnnxFault> {
    let mut fields = inner.fields();
    while let Some(field) = fields.next()? {
        let (true, Value::Bytes(node)) = (field.number == number, field.value) else { continue };
        let mut node_fields = node.fields();
        while let Some(field) = node_fields.next()? {
            let (5, Value::Bytes(attribute)) = (field.number, field.value) else { continue };
            let mut attribute_fields = attribute.fields();
            while let Some(field) = attribute_fields.next()? {
                match (field.number, field.value) {
                    (5 | 10, Value::Bytes(inner)) => tensor(inner)?,
                    (22 | 23, Value::Bytes(inner)) => sparse_tensor(inner)?,
                    (6 | 11, Value::Bytes(inner)) => graph(inner, depth + 1)?,
                    _ => {}
                }
            }
        }
    }
    Ok(())
}

/// SparseTensorProto: values 1, indices 2.
fn sparse_tensor(inner: Inner<'_>) -> Result<(), OnnxFault> {
    let mut fields = inner.fields();
    while let Some(field) = fields.next()? {
        if let (1 | 2, Value::Bytes(inner)) = (field.number, field.value) {
            tensor(inner)?;
        }
    }
    Ok(())
}

/// TensorProto: name 8, external_data 13, data_location 14 (1: external).
fn tensor(inner: Inner<'_>) -> Result<(), OnnxFault> {
    let (mut name, mut external) = (String::new(), false);
    let mut fields = inner.fields();
    while let Some(field) = fields.next()? {
        match (field.number, field.value) {
            (8, Value::Bytes(text)) => name = text.text(),
            (13, _) => external = true,
            (14, Value::Number(location)) => external |= location != 0,
            _ => {}
        }
    }
    if external { Err(OnnxFault::ExternalData { tensor: name }) } else { Ok(()) }
}

/// Bytes of a field, and where they begin in the file.
#[derive(Clone, Copy)]
struct Inner<'a> {
    bytes: &'a [u8],
    base: usize,
}

impl<'a> Inner<'a> {
    fn fields(self) -> Fields<'a> {
        Fields { bytes: self.bytes, at: 0, base: self.base }
    }

    /// At most 64 characters: it only names the thing in an error.
    fn text(self) -> String {
        String::from_utf8_lossy(self.bytes).chars().take(64).collect()
    }
}

struct Field<'a> {
    number: u64,
    value: Value<'a>,
}

enum Value<'a> {
    Number(u64),
    Bytes(Inner<'a>),
    /// Of fixed width: none that is needed here.
    Fixed,
}

/// The fields of one protobuf message in their order.
struct Fields<'a> {
    bytes: &'a [u8],
    at: usize,
    base: usize,
}

impl<'a> Fields<'a> {
    fn next(&mut self) -> Result<Option<Field<'a>>, OnnxFault> {
        if self.at >= self.bytes.len() {
            return Ok(None);
        }
        let key = self.varint()?;
        let value = match key & 7 {
            0 => Value::Number(self.varint()?),
            1 => self.take(8).map(|_| Value::Fixed)?,
            2 => {
                let length = usize::try_from(self.varint()?).map_err(|_| self.broken())?;
                let base = self.base + self.at;
                Value::Bytes(Inner { bytes: self.take(length)?, base })
            }
            5 => self.take(4).map(|_| Value::Fixed)?,
            _ => return Err(self.broken()),
        };
        Ok(Some(Field { number: key >> 3, value }))
    }

    fn varint(&mut self) -> Result<u64, OnnxFault> {
        let mut value = 0_u64;
        for shift in (0..64).step_by(7) {
            let byte = *self.bytes.get(self.at).ok_or_else(|| self.broken())?;
            self.at += 1;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(self.broken())
    }

    fn take(&mut self, length: usize) -> Result<&'a [u8], OnnxFault> {
        let end = self.at.checked_add(length).ok_or_else(|| self.broken())?;
        let taken = self.bytes.get(self.at..end).ok_or_else(|| self.broken())?;
        self.at = end;
        Ok(taken)
    }

    fn broken(&self) -> OnnxFault {
        OnnxFault::Broken { at: self.base + self.at }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn message(fields: &[(u64, &[u8])]) -> Vec<u8> {
        let mut bytes = Vec::new();
        for (number, value) in fields {
            varint(number << 3 | 2, &mut bytes);
            varint(value.len() as u64, &mut bytes);
            bytes.extend_from_slice(value);
        }
        bytes
    }

    fn varint(mut value: u64, bytes: &mut Vec<u8>) {
        while value >= 0x80 {
            bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        bytes.push(value as u8);
    }

    fn opset(domain: &[u8], version: u8) -> Vec<u8> {
        let mut inner = message(&[(1, domain)]);
        inner.extend([2 << 3, version]);
        inner
    }

    fn model_with(graph: &[u8]) -> Vec<u8> {
        message(&[(8, &opset(b"", 17)), (7, graph)])
    }

    #[test]
    fn the_models_of_the_tests_and_the_default_model_are_whole_files_of_a_known_opset() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut files: Vec<_> = std::fs::read_dir(root.join("tests/models"))
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect();
        files.push(root.join("../firmware-host/models/default.onnx"));
        assert!(files.len() > 30);
        for file in files {
            assert_eq!(
                check_onnx_file(&std::fs::read(&file).unwrap()),
                Ok(()),
                "{}",
                file.display()
            );
        }
    }

    #[test]
    fn opsets_that_robots_do_not_run_and_foreign_operators_are_refused() {
        for (version, taken) in [(10, false), (11, true), (21, true), (22, false)] {
            assert_eq!(
                check_onnx_file(&message(&[(8, &opset(b"", version))])).is_ok(),
                taken,
                "{version}"
            );
        }
        assert_eq!(check_onnx_file(&message(&[(7, b"")])), Err(OnnxFault::Opset { found: 0 }));
        let foreign = message(&[(8, &opset(b"", 17)), (8, &opset(b"com.example", 1))]);
        assert!(matches!(check_onnx_file(&foreign), Err(OnnxFault::Domain { .. })));
    }

    #[test]
    fn data_outside_is_found_wherever_a_tensor_may_stand() {
        let outside = message(&[(8, b"weights"), (13, b"")]);
        let mut by_location = message(&[(8, b"weights")]);
        by_location.extend([14 << 3, 1]);
        let node = |attribute: u64, inner: &[u8]| {
            message(&[(1, &message(&[(5, &message(&[(attribute, inner)]))]))])
        };
        let graphs = [
            message(&[(5, &outside)]),
            message(&[(5, &by_location)]),
            message(&[(15, &message(&[(2, &outside)]))]),
            node(5, &outside),
            node(10, &outside),
            node(22, &message(&[(1, &outside)])),
            node(6, &message(&[(5, &outside)])),
            node(11, &node(6, &message(&[(5, &outside)]))),
        ];
        for (index, graph) in graphs.iter().enumerate() {
            let refused = Err(OnnxFault::ExternalData { tensor: "weights".to_owned() });
            assert_eq!(check_onnx_file(&model_with(graph)), refused, "{index}");
        }
        assert_eq!(
            check_onnx_file(&model_with(&message(&[(5, &message(&[(8, b"weights")]))]))),
            Ok(())
        );
    }

    #[test]
    fn graphs_within_graphs_without_end_are_refused() {
        let mut graph = Vec::new();
        for _ in 0..40 {
            graph = message(&[(1, &message(&[(5, &message(&[(6, &graph)]))]))]);
        }
        assert_eq!(check_onnx_file(&model_with(&graph)), Err(OnnxFault::TooDeep));
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_model_or_a_fault(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            let _ = check_onnx_file(&bytes);
            let _ = check_onnx_file(&model_with(&bytes));
        }
    }
}
