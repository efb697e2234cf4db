//! Numeric data in buffers (glTF 2.0, section 3.6.2), with KHR_mesh_quantization.

use gltf::json::accessor::{ComponentType, GenericComponentType, Type};
use gltf::json::validation::Checked::Valid;
use gltf::json::{Accessor, Index};

use super::container::{File, size};
use crate::error::SceneError;

impl File {
    /// Reads vectors of at least N numbers and keeps the first N.
    pub fn floats<const N: usize>(
        &self,
        index: Index<Accessor>,
    ) -> Result<Vec<[f32; N]>, SceneError> {
        let elements = self.elements(index)?;
        if elements.components < N {
            return Err(self
                .malformed(format!("accessor {} has vectors that are too short", index.value())));
        }
        Ok(elements.iter().map(|bytes| std::array::from_fn(|i| elements.float(bytes, i))).collect())
    }

    pub fn indices(&self, index: Index<Accessor>) -> Result<Vec<u32>, SceneError> {
        let elements = self.elements(index)?;
        match elements.kind {
            ComponentType::U8 => Ok(elements.iter().map(|b| u32::from(b[0])).collect()),
            ComponentType::U16 => {
                Ok(elements.iter().map(|b| u32::from(u16::from_le_bytes([b[0], b[1]]))).collect())
            }
            ComponentType::U32 => {
                Ok(elements.iter().map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
            }
            _ => Err(self.malformed(format!(
                "accessor {} has indices that are not whole numbers",
                index.value()
            ))),
        }
    }

    fn elements(&self, index: Index<Accessor>) -> Result<Elements<'_>, SceneError> {
        let accessor = self.get(index, "accessor")?;
        let name = index.value();
        if accessor.sparse.is_some() {
            return Err(self.unsupported(
                "sparse accessors",
                "rewrite it with `gltf-transform copy in.glb out.glb`",
            ));
        }
        let (Valid(GenericComponentType(kind)), Valid(shape)) =
            (accessor.component_type, accessor.type_)
        else {
            return Err(
                self.malformed(format!("accessor {name} has a type that glTF does not have"))
            );
        };
        let Some(view_index) = accessor.buffer_view else {
            return Err(self.malformed(format!("accessor {name} has no data")));
        };
        let components = match shape {
            Type::Scalar => 1,
            Type::Vec2 => 2,
            Type::Vec3 => 3,
            Type::Vec4 => 4,
            _ => {
                return Err(self.malformed(format!(
                    "accessor {name} holds matrices, where vectors are expected"
                )));
            }
        };
        let width = components * component_width(kind);
        let stride = self
            .get(view_index, "buffer view")?
            .byte_stride
            .map_or(width, |stride| stride.0)
            .max(width);
        let start = accessor.byte_offset.map_or(0, size);
        let count = size(accessor.count);
        let end = match count.checked_sub(1) {
            Some(last) => last
                .checked_mul(stride)
                .and_then(|b| b.checked_add(width))
                .and_then(|b| b.checked_add(start)),
            None => Some(start),
        };
        let bytes = end
            .and_then(|end| self.view(view_index).map(|bytes| bytes.get(start..end)).transpose());
        let bytes = bytes.ok_or_else(|| {
            self.malformed(format!("accessor {name} reads outside of its buffer view"))
        })??;
        Ok(Elements { bytes, stride, width, kind, components, normalized: accessor.normalized })
    }
}

fn component_width(kind: ComponentType) -> usize {
    match kind {
        ComponentType::I8 | ComponentType::U8 => 1,
        ComponentType::I16 | ComponentType::U16 => 2,
        ComponentType::U32 | ComponentType::F32 => 4,
    }
}

struct Elements<'a> {
    bytes: &'a [u8],
    stride: usize,
    width: usize,
    kind: ComponentType,
    components: usize,
    normalized: bool,
}

impl Elements<'_> {
    fn iter(&self) -> impl Iterator<Item = &[u8]> {
        // The last element has no padding after it, so chunks may be short but never shorter than
        // `width`.
        self.bytes.chunks(self.stride).map(|chunk| &chunk[..self.width])
    }

    fn float(&self, element: &[u8], component: usize) -> f32 {
        let b = &element[component * component_width(self.kind)..];
        let (value, largest) = match self.kind {
            ComponentType::I8 => (f32::from(b[0].cast_signed()), 127.0),
            ComponentType::U8 => (f32::from(b[0]), 255.0),
            ComponentType::I16 => (f32::from(i16::from_le_bytes([b[0], b[1]])), 32_767.0),
            ComponentType::U16 => (f32::from(u16::from_le_bytes([b[0], b[1]])), 65_535.0),
            ComponentType::U32 => return u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f32,
            ComponentType::F32 => return f32::from_le_bytes([b[0], b[1], b[2], b[3]]),
        };
        if self.normalized { (value / largest).max(-1.0) } else { value }
    }
}
