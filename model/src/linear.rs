//! Affine layers with host-side initialisation and named access; initial values are equal on every backend.

use burn::{
    module::Param,
    nn::Linear,
    optim::GradientsParams,
    prelude::{Device, Tensor, TensorData},
    tensor::activation::relu,
};
use headtail_render::random::{Purpose, Stream};

use crate::{Error, NamedTensor, Result};

/// Seeded source of initial weights, drawn in the order of the exported names.
pub struct Initializer(Stream);

impl Initializer {
    /// Opens the stream of `seed`.
    pub fn new(seed: u64) -> Self {
        Self(Stream::new(seed, Purpose::Weights, 0))
    }

    /// Returns an affine layer initialised as PyTorch's `Linear`: weight and bias uniform in
    /// `+-1 / sqrt(inputs)`.
    ///
    /// This is `kaiming_uniform_(a = sqrt(5))` for the weight (He et al. 2015): bound
    /// `sqrt(6 / ((1 + a^2) inputs))`.
    pub fn linear(&mut self, inputs: usize, outputs: usize, device: &Device) -> Linear {
        let bound = 1.0 / (inputs as f32).sqrt();
        let mut draw =
            |count: usize| -> Vec<f32> { (0..count).map(|_| bound * (2.0 * self.0.uniform() - 1.0)).collect() };
        let weight = draw(inputs * outputs);
        let bias = draw(outputs);
        from_row_major(&weight, &bias, inputs, device)
    }
}

/// Returns an affine layer of zeros.
pub fn zeros(inputs: usize, outputs: usize, device: &Device) -> Linear {
    from_row_major(&vec![0.0; inputs * outputs], &vec![0.0; outputs], inputs, device)
}

/// Builds burn's layer, which stores `[in, out]`, from a row-major `[out, in]` matrix.
fn from_row_major(weight: &[f32], bias: &[f32], inputs: usize, device: &Device) -> Linear {
    let outputs = bias.len();
    let transposed = transpose(weight, outputs, inputs);
    Linear {
        weight: Param::from_data(TensorData::new(transposed, [inputs, outputs]), device),
        bias: Some(Param::from_data(TensorData::new(bias.to_vec(), [outputs]), device)),
    }
}

fn transpose(matrix: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    (0..columns).flat_map(|column| (0..rows).map(move |row| matrix[row * columns + column])).collect()
}

/// Reads a tensor back to the host.
pub(crate) fn read<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.try_into_vec_as::<f32>().expect("a tensor is readable and converts to f32")
}

/// Appends `{part}.linear0.weight` (`[out, in]`), `{part}.linear0.bias` (`[out]`), ... to `weights`.
pub(crate) fn export(layers: &[Linear], part: &str, weights: &mut Vec<NamedTensor>) {
    for (index, layer) in layers.iter().enumerate() {
        let name = |kind: &str| format!("{part}.linear{index}.{kind}");
        let [inputs, outputs] = layer.weight.val().dims();
        let values = transpose(&read(layer.weight.val()), inputs, outputs);
        weights.push(NamedTensor { name: name("weight"), shape: vec![outputs, inputs], values });
        if let Some(bias) = &layer.bias {
            weights.push(NamedTensor { name: name("bias"), shape: vec![outputs], values: read(bias.val()) });
        }
    }
}

/// Returns the number of values in the layers.
pub(crate) fn count<'a>(layers: impl Iterator<Item = &'a Linear>) -> usize {
    layers.map(value_count).sum()
}

fn value_count(layer: &Linear) -> usize {
    let [inputs, outputs] = layer.weight.val().dims();
    (inputs + 1) * outputs
}

/// Returns all values in one list: layer by layer a row-major `[out, in]` weight, then a bias.
pub(crate) fn flat_weights<'a>(layers: impl Iterator<Item = &'a Linear>) -> Vec<f32> {
    let mut flat = Vec::new();
    for layer in layers {
        flatten(layer.weight.val(), layer.bias.as_ref().map(Param::val), &mut flat);
    }
    flat
}

/// Returns the gradients in the order of [`flat_weights`]; 0 where the loss does not depend on a weight.
pub(crate) fn flat_gradients<'a>(layers: impl Iterator<Item = &'a Linear>, gradients: &GradientsParams) -> Vec<f32> {
    let mut flat = Vec::new();
    for layer in layers {
        let weight = gradients.get::<2>(layer.weight.id).unwrap_or_else(|| layer.weight.val().inner().zeros_like());
        let bias = layer.bias.as_ref().and_then(|bias| gradients.get::<1>(bias.id));
        flatten(weight, bias, &mut flat);
    }
    flat
}

/// Sets the layers' values from a list in the order of [`flat_weights`].
///
/// # Panics
/// If the list has a different length.
pub(crate) fn set_flat<'a>(layers: impl Iterator<Item = &'a mut Linear>, mut flat: &[f32], device: &Device) {
    for layer in layers {
        let [inputs, _] = layer.weight.val().dims();
        let (values, rest) = flat.split_at_checked(value_count(layer)).expect("one number for each weight");
        let (weight, bias) = values.split_at(values.len() / (inputs + 1) * inputs);
        *layer = from_row_major(weight, bias, inputs, device);
        flat = rest;
    }
    assert!(flat.is_empty(), "one number for each weight");
}

/// Appends a weight and a bias, given as burn's tensors (`[in, out]` and `[out]`), to `flat`, row-major
/// `[out, in]`.
fn flatten(weight: Tensor<2>, bias: Option<Tensor<1>>, flat: &mut Vec<f32>) {
    let [inputs, outputs] = weight.dims();
    flat.extend(transpose(&read(weight), inputs, outputs));
    flat.extend(bias.map_or_else(|| vec![0.0; outputs], read));
}

/// Removes the weights of `part` from `weights` (see [`export`]) and checks them against the shapes of
/// `layers`.
pub(crate) fn import(
    layers: &[Linear],
    part: &str,
    weights: &mut Vec<NamedTensor>,
    device: &Device,
) -> Result<Vec<Linear>> {
    let mut load = |(index, layer): (usize, &Linear)| {
        let [inputs, outputs] = layer.weight.val().dims();
        let weight = take(weights, format!("{part}.linear{index}.weight"), &[outputs, inputs])?;
        let bias = take(weights, format!("{part}.linear{index}.bias"), &[outputs])?;
        Ok(from_row_major(&weight, &bias, inputs, device))
    };
    layers.iter().enumerate().map(&mut load).collect()
}

fn take(weights: &mut Vec<NamedTensor>, name: String, expected: &[usize]) -> Result<Vec<f32>> {
    let Some(position) = weights.iter().position(|weight| weight.name == name) else {
        return Err(Error::MissingWeight(name));
    };
    let NamedTensor { shape, values, .. } = weights.swap_remove(position);
    if shape != expected || values.len() != expected.iter().product::<usize>() {
        return Err(Error::WeightShape { name, expected: expected.to_vec(), found: shape, values: values.len() });
    }
    if values.iter().any(|value| !value.is_finite()) {
        return Err(Error::NonFiniteWeight(name));
    }
    Ok(values)
}

/// Returns `x W` for `x` of shape `[conditions, samples, in]`, with columns `first..first + in` of the
/// layer's inputs only.
///
/// A spline network applies the condition's columns once per condition and the coordinate's columns once per
/// sample.
pub(crate) fn partial(linear: &Linear, first: usize, x: Tensor<3>) -> Tensor<3> {
    let [_, _, inputs] = x.dims();
    x.matmul(linear.weight.val().narrow(0, first, inputs).unsqueeze())
}

/// Returns `x W + b` for the layer's first inputs, see [`partial`].
pub(crate) fn affine(linear: &Linear, x: Tensor<3>) -> Tensor<3> {
    let product = partial(linear, 0, x);
    match &linear.bias {
        Some(bias) => product + bias.val().unsqueeze(),
        None => product,
    }
}

/// Returns `max(x, 0) + slope min(x, 0)`.
///
/// Uses `relu`, whose gradient is one pass: burn's leaky ReLU masks, which takes 10 % of a training step on a
/// CPU. `x - relu(x)` is exact, so the values are bit-identical.
pub(crate) fn leaky_relu<const D: usize>(x: Tensor<D>, slope: f64) -> Tensor<D> {
    let positive = relu(x.clone());
    (x - positive.clone()).mul_scalar(slope) + positive
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn initial_weights_depend_only_on_the_seed() {
        let device = crate::host();
        let draw = |seed: u64| read(Initializer::new(seed).linear(3, 5, &device).weight.val());
        assert_eq!(draw(7), draw(7));
        assert_ne!(draw(7), draw(8));
    }

    #[test]
    fn initial_weights_fill_the_range_within_the_bound() {
        let mut weights = Vec::new();
        export(&[Initializer::new(1).linear(64, 64, &crate::host())], "l", &mut weights);
        for weight in &weights {
            let largest = weight.values.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
            assert!(largest <= 0.125 && largest > 0.1, "{}: {largest}", weight.name);
        }
    }

    #[test]
    fn export_transposes_to_rows_of_outputs() {
        let device = crate::host();
        let linear = from_row_major(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], &[0.0, 10.0], 3, &device);
        // Row 1 of [out, in] is (4, 5, 6).
        let x = Tensor::<2>::from_data([[1.0, 0.5, 2.0]], &device);
        assert_eq!(read(linear.forward(x)), [1.0 + 1.0 + 6.0, 4.0 + 2.5 + 12.0 + 10.0]);
        let mut weights = Vec::new();
        export(&[linear], "l", &mut weights);
        assert_eq!(weights[0].shape, [2, 3]);
        assert_eq!(weights[0].values, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    }

    #[test]
    fn leaky_relu_equals_that_of_the_tensor_library() {
        let x = Tensor::<2>::from_data([[-3.7, -1e-30, 0.0, 1e-30, 0.3, 1e20, -1e20]], &crate::host());
        let expected = burn::tensor::activation::leaky_relu(x.clone(), 0.01);
        assert_eq!(read(leaky_relu(x, 0.01)), read(expected));
    }

    #[test]
    fn invalid_weights_are_rejected_by_name() {
        let device = crate::host();
        let linear = [zeros(2, 1, &device)];
        let good = |name: &str, shape: &[usize], values: &[f32]| NamedTensor {
            name: name.into(),
            shape: shape.to_vec(),
            values: values.to_vec(),
        };
        let bias = good("l.linear0.bias", &[1], &[0.0]);
        let attempt = |weight: NamedTensor| import(&linear, "l", &mut vec![bias.clone(), weight], &device).unwrap_err();
        assert_eq!(
            attempt(good("m.linear0.weight", &[1, 2], &[0.0; 2])),
            Error::MissingWeight("l.linear0.weight".into())
        );
        assert!(matches!(attempt(good("l.linear0.weight", &[2, 1], &[0.0; 2])), Error::WeightShape { .. }));
        assert!(matches!(attempt(good("l.linear0.weight", &[1, 2], &[0.0; 3])), Error::WeightShape { .. }));
        assert_eq!(
            attempt(good("l.linear0.weight", &[1, 2], &[0.0, f32::NAN])),
            Error::NonFiniteWeight("l.linear0.weight".into())
        );
    }
}
