//! The time of each shader in a step.

use headtail_shaders::gpu::Gpu;
use wgpu::BufferUsages;

use super::{
    DeviceFlow, DeviceGradient,
    dispatch::Dispatch,
    engine::{Engine, Prepared},
};
use crate::Result;

/// The time of the dispatches of one shader in a step, and their least cost.
#[derive(Clone, Debug, Default)]
pub struct KernelTime {
    /// The shader.
    pub name: String,
    /// Its dispatches.
    pub dispatches: usize,
    /// Their time.
    pub microseconds: f64,
    /// Floating-point operations of matrix products.
    pub operations: f64,
    /// Bytes read and written, if each number is read and written once.
    pub bytes: f64,
}

impl DeviceGradient {
    /// Repeats the last step, each dispatch in a pass of its own, and returns the time of each kind of shader. Empty
    /// before the first step, and on devices that cannot time their work.
    ///
    /// # Errors
    /// If the device fails.
    pub fn profile(&self) -> Result<Vec<KernelTime>> {
        self.prepared.as_ref().map_or(Ok(Vec::new()), |prepared| self.engine.profile(&prepared.step))
    }
}

impl DeviceFlow {
    /// As for heads, see [`DeviceGradient::profile`].
    ///
    /// # Errors
    /// If the device fails.
    pub fn profile(&self) -> Result<Vec<KernelTime>> {
        self.prepared.as_ref().map_or(Ok(Vec::new()), |(_, prepared)| self.engine.profile(prepared))
    }
}

impl Engine {
    fn profile(&self, prepared: &Prepared) -> Result<Vec<KernelTime>> {
        if !self.gpu.has_timestamps() {
            return Ok(Vec::new());
        }
        let mut times: Vec<KernelTime> = Vec::new();
        let mut index = 0;
        for piece in &prepared.plan.pieces {
            let nanoseconds = self.time(prepared, piece, index)?;
            index += piece.len() as u32;
            for (dispatch, nanoseconds) in piece.iter().zip(nanoseconds) {
                let name = format!("{:?}", dispatch.kernel);
                let place = times.iter().position(|time| time.name == name).unwrap_or_else(|| {
                    times.push(KernelTime { name, ..KernelTime::default() });
                    times.len() - 1
                });
                let KernelTime { dispatches, microseconds, operations, bytes, .. } = &mut times[place];
                *dispatches += 1;
                *microseconds += nanoseconds / 1e3;
                *operations += dispatch.cost.operations;
                *bytes += dispatch.cost.bytes;
            }
        }
        Ok(times)
    }

    /// Returns the nanoseconds of each dispatch of a piece, the first of which has number `first`.
    fn time(&self, prepared: &Prepared, piece: &[Dispatch], first: u32) -> Result<Vec<f64>> {
        let Gpu { device, queue, .. } = &self.gpu;
        let count = 2 * piece.len() as u32;
        let descriptor = wgpu::QuerySetDescriptor { label: None, ty: wgpu::QueryType::Timestamp, count };
        let queries = device.create_query_set(&descriptor);
        let mut encoder = device.create_command_encoder(&Default::default());
        for (index, dispatch) in (0..).zip(piece) {
            let timestamp_writes = Some(wgpu::ComputePassTimestampWrites {
                query_set: &queries,
                beginning_of_pass_write_index: Some(2 * index),
                end_of_pass_write_index: Some(2 * index + 1),
            });
            let descriptor = wgpu::ComputePassDescriptor { label: None, timestamp_writes };
            self.dispatch(&mut encoder.begin_compute_pass(&descriptor), prepared, dispatch, first + index);
        }
        let (size, usage) = (8 * u64::from(count), BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC);
        let descriptor = wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false };
        let resolved = device.create_buffer(&descriptor);
        encoder.resolve_query_set(&queries, 0..count, &resolved, 0);
        queue.submit([encoder.finish()]);
        let ticks: Vec<u64> = self.gpu.read(&resolved, 0, count as usize)?;
        let period = f64::from(queue.get_timestamp_period());
        Ok(ticks.chunks_exact(2).map(|pair| pair[1].saturating_sub(pair[0]) as f64 * period).collect())
    }
}
