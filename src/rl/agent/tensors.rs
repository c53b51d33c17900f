//! Tensors as safetensors files, in memory: `store` writes and checks them.

use std::path::{Path, PathBuf};

use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView, serialize};
use tch::{Device, Tensor};

use super::damage::{CheckpointError, invalid};
use super::network::QNetwork;

/// The bytes of a file of `float32` tensors, whatever device they are on.
pub(super) fn pack(tensors: &[(String, Tensor)]) -> Vec<u8> {
    let pack = |(name, tensor): &(String, Tensor)| {
        let row = tensor.to_device(Device::Cpu).flatten(0, -1);
        let values = Vec::<f32>::try_from(&row).expect("parameters and moments are float32");
        let bytes: Vec<u8> = values.into_iter().flat_map(f32::to_le_bytes).collect();
        let shape = tensor.size().iter().map(|&side| side as usize).collect();
        (name.clone(), shape, bytes)
    };
    let packed: Vec<(String, Vec<usize>, Vec<u8>)> = tensors.iter().map(pack).collect();
    let views = packed.iter().map(|(name, shape, bytes)| {
        let view = TensorView::new(Dtype::F32, shape.clone(), bytes);
        (name, view.expect("as many bytes as its shape takes"))
    });
    serialize(views, &None).expect("writing to memory cannot fail")
}

/// The tensors of a network's parameters, named with a prefix.
pub(super) fn named(network: &QNetwork, prefix: &str) -> Vec<(String, Tensor)> {
    network.named().map(|(name, one)| (format!("{prefix}{name}"), one)).collect()
}

/// The tensors of a file.
pub(super) struct Tensors {
    path: PathBuf,
    tensors: Vec<(String, Tensor)>,
}

impl Tensors {
    /// Reads the bytes of a file, whose path errors name.
    pub(super) fn unpack(path: &Path, bytes: &[u8]) -> Result<Self, CheckpointError> {
        let file = SafeTensors::deserialize(bytes).map_err(|error| invalid(path, &error))?;
        let tensor = |(name, view)| {
            let tensor = Tensor::try_from(view).map_err(|error| invalid(path, &error))?;
            Ok::<_, CheckpointError>((name, tensor))
        };
        let tensors = file.tensors().into_iter().map(tensor).collect::<Result<_, _>>()?;
        Ok(Self { path: path.to_owned(), tensors })
    }

    /// The tensor of a name, which has the shape of another and finite values.
    pub(super) fn find(&self, name: &str, like: &Tensor) -> Result<Tensor, CheckpointError> {
        let found = self.tensors.iter().find(|(found, _)| found == name);
        let (_, found) = found.ok_or_else(|| invalid(&self.path, &format!("no {name}")))?;
        if found.size() != like.size() || found.kind() != like.kind() {
            let (found, expected) = (found.size(), like.size());
            let reason = format!("{name} is {found:?}, expected {expected:?}");
            return Err(invalid(&self.path, &reason));
        }
        if found.isfinite().all().int64_value(&[]) == 0 {
            let reason = format!(
                "{name} has values that are not finite, so nothing can be computed with it: take \
                 another checkpoint"
            );
            return Err(invalid(&self.path, &reason));
        }
        Ok(found.shallow_clone())
    }

    /// The tensors of a network's parameters, in their order.
    pub(super) fn of(
        &self,
        network: &QNetwork,
        prefix: &str,
    ) -> Result<Vec<Tensor>, CheckpointError> {
        let find = |(name, like): (&str, Tensor)| self.find(&format!("{prefix}{name}"), &like);
        network.named().map(find).collect()
    }
}
