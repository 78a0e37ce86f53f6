//! Reading accessors: typed elements in a buffer view.

use gltf::json::{
    Accessor, Index,
    accessor::{ComponentType, Type},
    validation::Checked,
};

use super::document::Document;
use crate::error::Result;

/// The elements of an accessor, all of them inside the buffer.
struct Elements<'a> {
    /// From the first byte of the first element to the last byte of the last one.
    bytes: &'a [u8],
    stride: usize,
    count: usize,
    component: ComponentType,
    normalized: bool,
}

/// Reads an accessor of vectors of `N` components as floats; integers are normalised where the accessor says so.
pub fn read_vectors<const N: usize>(
    document: &Document,
    accessor: Index<Accessor>,
    field: &str,
) -> Result<Vec<[f32; N]>> {
    let kind = match N {
        2 => Type::Vec2,
        3 => Type::Vec3,
        _ => Type::Vec4,
    };
    let elements = elements(document, accessor, kind, N, field)?;
    let size = elements.component.size();
    let convert = |bytes: &[u8]| std::array::from_fn(|i| elements.float(&bytes[i * size..(i + 1) * size]));
    Ok((0..elements.count).map(|i| convert(&elements.bytes[i * elements.stride..])).collect())
}

/// Reads an accessor of vertex indices.
pub fn read_indices(document: &Document, accessor: Index<Accessor>, field: &str) -> Result<Vec<u32>> {
    let elements = elements(document, accessor, Type::Scalar, 1, field)?;
    let convert: fn(&[u8]) -> u32 = match elements.component {
        ComponentType::U8 => |b| u32::from(b[0]),
        ComponentType::U16 => |b| u32::from(u16::from_le_bytes([b[0], b[1]])),
        ComponentType::U32 => |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]),
        other => return Err(document.invalid(field, format!("indices cannot be of type {other:?}"))),
    };
    Ok((0..elements.count).map(|i| convert(&elements.bytes[i * elements.stride..])).collect())
}

/// Finds the bytes of an accessor, and checks that all of its elements are there.
fn elements<'a>(
    document: &'a Document,
    index: Index<Accessor>,
    kind: Type,
    components: usize,
    field: &str,
) -> Result<Elements<'a>> {
    let accessor = document.get(index, field)?;
    let field = format!("accessors[{}]", index.value());
    let invalid = |part: &str, reason: String| document.invalid(format!("{field}.{part}"), reason);

    let Checked::Valid(component) = accessor.component_type else {
        return Err(invalid("componentType", "is not a component type of glTF".into()));
    };
    let component = component.0;
    match accessor.type_ {
        Checked::Valid(found) if found == kind => {}
        Checked::Valid(found) => return Err(invalid("type", format!("is {found:?}, but must be {kind:?} here"))),
        Checked::Invalid => return Err(invalid("type", "is not an accessor type of glTF".into())),
    }
    if accessor.sparse.is_some() {
        return Err(invalid("sparse", "sparse accessors are not supported".into()));
    }
    let Some(view) = accessor.buffer_view else {
        return Err(invalid("bufferView", "is missing".into()));
    };
    let (bytes, stride) = document.view(view.value(), &field)?;

    let size = component.size() * components;
    let stride = stride.unwrap_or(size);
    if stride < size {
        let reason = format!("is {stride}, less than the {size} bytes of an element of {field}");
        return Err(document.invalid(format!("bufferViews[{}].byteStride", view.value()), reason));
    }
    let count = accessor.count.0;
    let offset = accessor.byte_offset.map_or(0, |offset| offset.0);
    let end = match count {
        0 => Some(offset),
        _ => (count - 1).checked_mul(stride as u64).and_then(|n| n.checked_add(size as u64)?.checked_add(offset)),
    };
    let Some(end) = end.filter(|&end| end <= bytes.len() as u64 && offset <= end) else {
        let reason =
            format!("{count} elements from byte {offset} on are more than the {} bytes there are", bytes.len());
        return Err(invalid("count", reason));
    };
    document.reserve_elements(count, &format!("{field}.count"))?;
    // Both are at most the length of a slice.
    let bytes = &bytes[offset as usize..end as usize];
    Ok(Elements { bytes, stride, count: count as usize, component, normalized: accessor.normalized })
}

impl Elements<'_> {
    /// One component as a float.
    fn float(&self, b: &[u8]) -> f32 {
        let (value, most) = match self.component {
            ComponentType::I8 => (f32::from(b[0] as i8), f32::from(i8::MAX)),
            ComponentType::U8 => (f32::from(b[0]), f32::from(u8::MAX)),
            ComponentType::I16 => (f32::from(i16::from_le_bytes([b[0], b[1]])), f32::from(i16::MAX)),
            ComponentType::U16 => (f32::from(u16::from_le_bytes([b[0], b[1]])), f32::from(u16::MAX)),
            ComponentType::U32 => (u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f32, u32::MAX as f32),
            ComponentType::F32 => return f32::from_le_bytes([b[0], b[1], b[2], b[3]]),
        };
        if self.normalized { (value / most).max(-1.0) } else { value }
    }
}
