//! Objects by handle: a closed or unknown handle is an error, not a memory fault.

use std::{
    collections::HashMap,
    sync::{Arc, LazyLock, PoisonError, RwLock},
};

use headtail_sampling::{
    batch::{FittedMaterial, PreparedPoints},
    environment::Environment,
    sampler::Sampler,
};

use crate::status::Failure;

/// The object of a handle.
#[derive(Clone)]
pub enum Object {
    Environment(Arc<Environment>),
    Sampler(Arc<OpenSampler>),
    Prepared(Arc<OpenPoints>),
    Material(Arc<FittedMaterial>),
}

impl Object {
    fn name(&self) -> &'static str {
        match self {
            Self::Environment(_) => "an environment",
            Self::Sampler(_) => "a sampler",
            Self::Prepared(_) => "prepared points",
            Self::Material(_) => "a material",
        }
    }
}

/// A sampler with its map.
pub struct OpenSampler {
    pub sampler: Arc<dyn Sampler>,
    pub environment: Arc<Environment>,
    pub needs_positions: bool,
    /// The description, JSON.
    pub description: String,
}

/// Points that were prepared for a sampler.
pub struct OpenPoints {
    pub points: PreparedPoints,
    pub environment: Arc<Environment>,
}

#[derive(Default)]
struct Table {
    last: u64,
    objects: HashMap<u64, Object>,
}

static TABLE: LazyLock<RwLock<Table>> = LazyLock::new(RwLock::default);

/// Stores an object and returns its handle, which is never 0 and never reused.
pub fn open(object: Object) -> u64 {
    let mut table = TABLE.write().unwrap_or_else(PoisonError::into_inner);
    table.last += 1;
    let handle = table.last;
    table.objects.insert(handle, object);
    handle
}

/// Returns the object of a handle. It stays alive during a call, even if another thread closes it.
fn object(handle: u64) -> Result<Object, Failure> {
    let table = TABLE.read().unwrap_or_else(PoisonError::into_inner);
    table.objects.get(&handle).cloned().ok_or_else(|| Failure::argument(format!("handle {handle}: is not open")))
}

/// Closes a handle.
pub fn close(handle: u64) -> Result<(), Failure> {
    let mut table = TABLE.write().unwrap_or_else(PoisonError::into_inner);
    table.objects.remove(&handle).map(|_| ()).ok_or_else(|| Failure::argument(format!("handle {handle}: is not open")))
}

pub fn environment(handle: u64) -> Result<Arc<Environment>, Failure> {
    match object(handle)? {
        Object::Environment(environment) => Ok(environment),
        other => Err(wrong(handle, &other, "an environment")),
    }
}

pub fn sampler(handle: u64) -> Result<Arc<OpenSampler>, Failure> {
    match object(handle)? {
        Object::Sampler(sampler) => Ok(sampler),
        other => Err(wrong(handle, &other, "a sampler")),
    }
}

pub fn prepared(handle: u64) -> Result<Arc<OpenPoints>, Failure> {
    match object(handle)? {
        Object::Prepared(points) => Ok(points),
        other => Err(wrong(handle, &other, "prepared points")),
    }
}

pub fn material(handle: u64) -> Result<Arc<FittedMaterial>, Failure> {
    match object(handle)? {
        Object::Material(material) => Ok(material),
        other => Err(wrong(handle, &other, "a material")),
    }
}

fn wrong(handle: u64, found: &Object, needed: &str) -> Failure {
    Failure::argument(format!("handle {handle}: is {}, not {needed}", found.name()))
}
