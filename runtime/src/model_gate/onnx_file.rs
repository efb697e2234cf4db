//! Checks an ONNX file before an inference runtime parses it: it must use a supported opset and
//! keep all weights inside.
//!
//! The check reads only the protobuf fields that it needs and skips the rest (onnx.proto3 of ONNX
//! 1.16; the field numbers are part of that format and do not change). It never allocates memory by
//! a length from the file.

use std::ops::RangeInclusive;

/// Accepted opsets of `ai.onnx`. The oldest exporters in use write 11. ONNX Runtime supports 21
/// since version 1.20, and the robot requires version 1.22. `tools/trainer` writes 17.
pub const OPSETS: RangeInclusive<i64> = 11..=21;
/// Largest nesting of subgraphs; a loop in a loop in a branch has three levels.
const MAX_DEPTH: usize = 16;

/// Why a file may not be loaded.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum OnnxFault {
    /// The file is not a protobuf message or is truncated.
    #[error(
        "the file is not a complete ONNX model (it is truncated or not ONNX at byte {at}); export it again"
    )]
    Broken { at: usize },
    /// The opset is not supported, or missing (0).
    #[error("the model uses opset {found}, allowed: {} to {}; export it with opset 17", OPSETS.start(), OPSETS.end())]
    Opset { found: i64 },
    /// The model uses operators of another domain than ONNX's own.
    #[error("the model needs operators of `{domain}`; export it with ONNX's own operators only")]
    Domain { domain: String },
    /// The model keeps weights in other files.
    #[error(
        "the model keeps the tensor `{tensor}` in another file; export it with all weights inside (one file)"
    )]
    ExternalData { tensor: String },
    /// Subgraphs are nested deeper than in any real network.
    #[error("the model nests graphs more than {MAX_DEPTH} deep; no depth network needs that")]
    TooDeep,
}

/// Checks the bytes of an ONNX file.
///
/// # Errors
/// The first fault in the file.
pub fn check_onnx_file(bytes: &[u8]) -> Result<(), OnnxFault> {
    let mut opset = 0;
    let mut fields = Fields { bytes, at: 0, base: 0 };
    while let Some(field) = fields.next()? {
        match (field.number, field.value) {
            // ModelProto.opset_import: domain 1, version 2.
            (8, Value::Bytes(inner)) => match opset_import(inner)? {
                (domain, version) if domain.is_empty() || domain == "ai.onnx" => opset = version,
                // ONNX's own second domain.
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
    let mut domain = String::new();
    let mut version = 0;
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
    if depth > MAX_DEPTH {
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

/// NodeProto: attribute 5. AttributeProto: t 5, g 6, tensors 10, graphs 11, sparse_tensor 22,
/// sparse_tensors 23.
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
    let mut name = String::new();
    let mut external = false;
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

/// The bytes of a field and their offset in the file.
#[derive(Clone, Copy)]
struct Inner<'a> {
    bytes: &'a [u8],
    base: usize,
}

impl<'a> Inner<'a> {
    fn fields(self) -> Fields<'a> {
        Fields { bytes: self.bytes, at: 0, base: self.base }
    }

    /// The first 64 characters, for an error message.
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
    /// A value of fixed width; none of the checked fields has one.
    Fixed,
}

/// Iterates over the fields of one protobuf message.
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

    /// A graph of one node with this attribute.
    fn node(attribute: u64, inner: &[u8]) -> Vec<u8> {
        message(&[(1, &message(&[(5, &message(&[(attribute, inner)]))]))])
    }

    fn model_with(graph: &[u8]) -> Vec<u8> {
        message(&[(8, &opset(b"", 17)), (7, graph)])
    }

    #[test]
    fn the_test_models_and_the_default_model_are_accepted() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut files: Vec<_> = std::fs::read_dir(root.join("tests/models"))
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect();
        files.push(root.join("../firmware-host/models/default.onnx"));
        assert!(files.len() > 20);
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
    fn unsupported_opsets_and_foreign_operators_are_refused() {
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
    fn external_data_is_found_in_every_place_of_a_tensor() {
        let outside = message(&[(8, b"weights"), (13, b"")]);
        let mut by_location = message(&[(8, b"weights")]);
        by_location.extend([14 << 3, 1]);
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
    fn deeply_nested_graphs_are_refused() {
        let mut graph = Vec::new();
        for _ in 0..40 {
            graph = message(&[(1, &message(&[(5, &message(&[(6, &graph)]))]))]);
        }
        assert_eq!(check_onnx_file(&model_with(&graph)), Err(OnnxFault::TooDeep));
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            let _ = check_onnx_file(&bytes);
            let _ = check_onnx_file(&model_with(&bytes));
        }
    }
}
