//! Reading accessors: typed elements in a buffer view, some of which may be replaced by sparse ones.

use super::{
    document::Document,
    json::{Accessor, Sparse, Whole},
};
use crate::error::Result;

/// Maximum number of elements of an accessor without a buffer view. They are zero, and a few bytes of JSON
/// can request any number of them.
const MAX_BARE_ELEMENTS: u64 = 1 << 22;

/// The type of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn of(code: Whole) -> Option<Self> {
        Some(match code.0 {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// The number at the start of `b`, and the number that represents 1 where numbers are normalised.
    fn float(self, b: &[u8]) -> (f32, f32) {
        match self {
            Self::I8 => (f32::from(b[0] as i8), f32::from(i8::MAX)),
            Self::U8 => (f32::from(b[0]), f32::from(u8::MAX)),
            Self::I16 => (f32::from(i16::from_le_bytes([b[0], b[1]])), f32::from(i16::MAX)),
            Self::U16 => (f32::from(u16::from_le_bytes([b[0], b[1]])), f32::from(u16::MAX)),
            Self::U32 => (u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f32, u32::MAX as f32),
            Self::F32 => (f32::from_le_bytes([b[0], b[1], b[2], b[3]]), 1.0),
        }
    }

    /// The integer at the start of `b`, of one of the three types of indices.
    fn index(self, b: &[u8]) -> u32 {
        match self {
            Self::U8 => u32::from(b[0]),
            Self::U16 => u32::from(u16::from_le_bytes([b[0], b[1]])),
            _ => u32::from_le_bytes([b[0], b[1], b[2], b[3]]),
        }
    }

    fn is_index(self) -> bool {
        matches!(self, Self::U8 | Self::U16 | Self::U32)
    }
}

/// Elements of one component type, all of them inside a buffer view.
struct Elements<'a> {
    /// From the first byte of the first element to the last byte of the last one.
    bytes: &'a [u8],
    stride: usize,
    count: usize,
    component: Component,
}

impl<'a> Elements<'a> {
    /// Finds `count` elements at an offset of a buffer view; `field` is the accessor, or its part.
    fn find(
        document: &'a Document,
        (view, offset): (Whole, Whole),
        count: Whole,
        (component, components): (Component, usize),
        field: &str,
    ) -> Result<Self> {
        let (bytes, stride) = document.view(view, field)?;
        let size = component.size() * components;
        let stride = stride.unwrap_or(size);
        if stride < size {
            let reason = format!("is {stride}, less than the {size} bytes of an element of {field}");
            return Err(document.invalid(format!("bufferViews[{}].byteStride", view.0), reason));
        }
        let (count, offset) = (count.0, offset.0);
        let end = match count {
            0 => Some(offset),
            _ => (count - 1).checked_mul(stride as u64).and_then(|n| n.checked_add(size as u64)?.checked_add(offset)),
        };
        let Some(end) = end.filter(|&end| end <= bytes.len() as u64 && offset <= end) else {
            let reason =
                format!("{count} elements from byte {offset} on are more than the {} bytes there are", bytes.len());
            return Err(document.invalid(format!("{field}.count"), reason));
        };
        // Both are at most the length of a slice.
        let bytes = &bytes[offset as usize..end as usize];
        Ok(Self { bytes, stride, count: count as usize, component })
    }

    /// The bytes from the start of each element on.
    fn iter(&self) -> impl Iterator<Item = &'a [u8]> + use<'a, '_> {
        (0..self.count).map(|i| &self.bytes[i * self.stride..])
    }

    fn vectors<const N: usize>(&self, normalized: bool) -> impl Iterator<Item = [f32; N]> + use<'a, '_, N> {
        let (component, size) = (self.component, self.component.size());
        self.iter().map(move |bytes| {
            std::array::from_fn(|i| {
                let (value, one) = component.float(&bytes[i * size..]);
                if normalized { (value / one).max(-1.0) } else { value }
            })
        })
    }
}

/// Returns whether the type of an accessor has `N` components.
pub fn has_components<const N: usize>(document: &Document, accessor: Whole) -> bool {
    document.root().accessors.get(accessor.index()).is_some_and(|accessor| accessor.kind == kind::<N>())
}

fn kind<const N: usize>() -> &'static str {
    match N {
        1 => "SCALAR",
        2 => "VEC2",
        3 => "VEC3",
        4 => "VEC4",
        _ => "MAT4",
    }
}

/// Reads an accessor of vectors of `N` components as floats; integers are normalised where the accessor says so.
pub fn read_vectors<const N: usize>(document: &Document, accessor: Whole, field: &str) -> Result<Vec<[f32; N]>> {
    let (accessor, component, field) = checked(document, accessor, kind::<N>(), field)?;
    let normalized = accessor.normalized && component != Component::F32;
    let mut values: Vec<[f32; N]> = match accessor.buffer_view {
        Some(view) => {
            let place = (view, accessor.byte_offset);
            Elements::find(document, place, accessor.count, (component, N), &field)?.vectors(normalized).collect()
        }
        None => vec![[0.0; N]; bare_count(document, accessor, &field)?],
    };
    if let Some(sparse) = &accessor.sparse {
        let (indices, elements) = sparse_parts(document, sparse, (component, N), &field)?;
        for (index, value) in indices.into_iter().zip(elements.vectors(normalized)) {
            *sparse_place(document, &mut values, index, &field)? = value;
        }
    }
    Ok(values)
}

/// Reads an accessor of vertex indices.
pub fn read_indices(document: &Document, accessor: Whole, field: &str) -> Result<Vec<u32>> {
    let place = field;
    let (accessor, component, field) = checked(document, accessor, kind::<1>(), field)?;
    if !component.is_index() {
        return Err(document.invalid(place, format!("indices cannot be of type {component:?}")));
    }
    let mut values: Vec<u32> = match accessor.buffer_view {
        Some(view) => {
            let elements =
                Elements::find(document, (view, accessor.byte_offset), accessor.count, (component, 1), &field)?;
            elements.iter().map(|bytes| component.index(bytes)).collect()
        }
        None => vec![0; bare_count(document, accessor, &field)?],
    };
    if let Some(sparse) = &accessor.sparse {
        let (indices, elements) = sparse_parts(document, sparse, (component, 1), &field)?;
        for (index, bytes) in indices.into_iter().zip(elements.iter()) {
            *sparse_place(document, &mut values, index, &field)? = component.index(bytes);
        }
    }
    Ok(values)
}

/// Returns the accessor of an index, its component type and its field; counts its elements towards the limit.
fn checked<'a>(
    document: &'a Document,
    index: Whole,
    kind: &str,
    field: &str,
) -> Result<(&'a Accessor, Component, String)> {
    let accessor = document.get(&document.root().accessors, index, field)?;
    let field = format!("accessors[{}]", index.0);
    let Some(component) = Component::of(accessor.component_type) else {
        return Err(document.invalid(format!("{field}.componentType"), "is not a component type of glTF"));
    };
    if accessor.kind != kind {
        let found = accessor.kind.escape_debug();
        return Err(document.invalid(format!("{field}.type"), format!("is {found}, but must be {kind} here")));
    }
    // A count beyond the buffer is rejected later, with a clearer error.
    document.reserve_elements(accessor.count.0.min(u64::from(u32::MAX)), &format!("{field}.count"))?;
    Ok((accessor, component, field))
}

/// Returns the number of zeros of an accessor without a buffer view.
fn bare_count(document: &Document, accessor: &Accessor, field: &str) -> Result<usize> {
    match accessor.count.0 {
        count @ 0..=MAX_BARE_ELEMENTS => Ok(count as usize),
        count => {
            Err(document.invalid(format!("{field}.bufferView"), format!("is missing, and there are {count} elements")))
        }
    }
}

/// Indices and values of sparse elements.
fn sparse_parts<'a>(
    document: &'a Document,
    sparse: &Sparse,
    shape: (Component, usize),
    field: &str,
) -> Result<(Vec<u32>, Elements<'a>)> {
    let (field, count) = (format!("{field}.sparse"), sparse.count);
    let component = sparse.indices.component_type.and_then(Component::of).filter(|component| component.is_index());
    let Some(component) = component else {
        return Err(document.invalid(format!("{field}.indices.componentType"), "is not a type of indices"));
    };
    let part = format!("{field}.indices");
    let place = (sparse.indices.buffer_view, sparse.indices.byte_offset);
    let indices = Elements::find(document, place, count, (component, 1), &part)?;
    let indices = indices.iter().map(|bytes| component.index(bytes)).collect();
    let place = (sparse.values.buffer_view, sparse.values.byte_offset);
    Ok((indices, Elements::find(document, place, count, shape, &format!("{field}.values"))?))
}

fn sparse_place<'a, T>(document: &Document, values: &'a mut [T], index: u32, field: &str) -> Result<&'a mut T> {
    let count = values.len();
    values.get_mut(index as usize).ok_or_else(|| {
        document.invalid(format!("{field}.sparse.indices"), format!("index {index} is out of range: there are {count}"))
    })
}
