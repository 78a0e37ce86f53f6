"""Small networks in Dr.Jit: affine layers with leaky ReLU between them."""

import drjit as dr
import mitsuba as mi
import numpy as np

BLOCK = 4


class Layer:
    """y = W x + b, with the layout of `Head::flat` of the crate headtail-sampling."""

    def __init__(self, numbers, row):
        self.inputs, self.outputs, weights, biases = (int(number) for number in row)
        blocks = -(-self.outputs // BLOCK)
        own = numbers[weights : weights + blocks * self.inputs * BLOCK].reshape(blocks, self.inputs, BLOCK)
        self.weight = np.ascontiguousarray(own.transpose(0, 2, 1).reshape(-1, self.inputs)[: self.outputs])
        self.bias = np.ascontiguousarray(numbers[biases : biases + self.outputs])


class Network:
    """A sequence of layers with a leaky ReLU after each, or after each but the last.

    LLVM variants multiply matrices with cooperative vectors. CUDA has these in half precision only, so it uses loops
    over local memory.
    """

    def __init__(self, layers, slope, ends_leaky=False, loops=None):
        self.layers, self.slope, self.ends_leaky = layers, slope, ends_leaky
        self.loops = mi.variant().startswith("cuda") if loops is None else loops
        if self.loops:
            self.numbers = [(mi.Float(layer.weight.ravel()), mi.Float(layer.bias)) for layer in layers]
        elif layers:
            tensors = [mi.TensorXf(array) for layer in layers for array in (layer.weight, layer.bias)]
            views = dr.nn.pack(*tensors, layout="inference")
            self.numbers = list(zip(views[::2], views[1::2]))

    def __call__(self, inputs):
        """Returns the outputs for a list of inputs."""
        if not self.layers:
            return []
        return self.by_loops(inputs) if self.loops else self.by_vectors(inputs)

    def is_leaky(self, index):
        return self.ends_leaky or index + 1 < len(self.layers)

    def by_vectors(self, inputs):
        vector = dr.nn.CoopVec(*inputs)
        for index, (weight, bias) in enumerate(self.numbers):
            vector = dr.nn.matvec(weight, vector, bias)
            if self.is_leaky(index):
                vector = dr.maximum(vector, vector * self.slope)
        return list(vector)

    def by_loops(self, inputs):
        widest = max(len(inputs), *(layer.outputs for layer in self.layers))
        numbers = dr.alloc_local(mi.Float, widest)
        for index, number in enumerate(inputs):
            numbers[index] = number
        for index, (layer, own) in enumerate(zip(self.layers, self.numbers)):
            slope = self.slope if self.is_leaky(index) else 1.0
            numbers = product(*own, layer.inputs, layer.outputs, numbers, widest, slope)
        return [numbers[index] for index in range(self.layers[-1].outputs)]


@dr.syntax
def product(weight, bias, inputs, outputs, given, widest, slope):
    """Evaluates one layer from and to local memory; a slope of 1 means no activation."""
    out, row = dr.alloc_local(mi.Float, widest), mi.UInt32(0)
    while row < outputs:
        total, column = dr.gather(mi.Float, bias, row), mi.UInt32(0)
        while column < inputs:
            total = dr.fma(dr.gather(mi.Float, weight, row * inputs + column), given[column], total)
            column += 1
        out[row] = dr.maximum(total, slope * total)
        row += 1
    return out
