//! Where and with what numbers tensors are computed.

use tch::{Cuda, Device, Kind, Tensor, kind::Element};

use crate::config::Precision;
use crate::error::{Fault, HasFault};

/// The library that knows of graphics cards, which programs are not linked with.
#[cfg(target_os = "linux")]
const CUDA_LIBRARY: &str = "libtorch_cuda.so";

/// A device that was asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeviceChoice {
    /// A graphics card with CUDA if there is one, else the CPU.
    Auto,
    /// The CPU.
    Cpu,
    /// The first graphics card.
    Cuda,
}

/// There is no such device.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error(
    "no device with CUDA: {reason}; train with --device cpu, or put the lib directories of PyTorch \
     2.11 and its CUDA packages into LD_LIBRARY_PATH"
)]
pub struct NoDevice {
    reason: String,
}

impl HasFault for NoDevice {
    fn fault(&self) -> Fault {
        Fault::Running
    }
}

impl DeviceChoice {
    /// The device. That of CUDA needs its library, which is loaded here: call it before anything
    /// else asks libtorch for devices.
    ///
    /// # Errors
    /// If CUDA is demanded and there is none.
    pub fn device(self) -> Result<Device, NoDevice> {
        if self == Self::Cpu {
            return Ok(Device::Cpu);
        }
        match load_cuda() {
            Ok(()) if Cuda::is_available() => Ok(Device::Cuda(0)),
            _ if self == Self::Auto => Ok(Device::Cpu),
            Ok(()) => Err(NoDevice { reason: "libtorch finds no graphics card".into() }),
            Err(reason) => Err(NoDevice { reason }),
        }
    }
}

/// Loads what libtorch needs for CUDA, and keeps it for as long as the program runs.
#[cfg(target_os = "linux")]
fn load_cuda() -> Result<(), String> {
    use std::error::Error;

    use libloading::os::unix::{Library, RTLD_GLOBAL, RTLD_NOW};
    // SAFETY: the library is that of the libtorch in use, whose initialisation is meant to run here.
    #[allow(unsafe_code, reason = "loading a library runs its initialisation")]
    let library = unsafe { Library::open(Some(CUDA_LIBRARY), RTLD_NOW | RTLD_GLOBAL) };
    let reason = |error: libloading::Error| match error.source() {
        Some(reason) => reason.to_string(),
        None => error.to_string(),
    };
    library.map(std::mem::forget).map_err(reason)
}

/// Elsewhere nothing is loaded that was not linked.
#[cfg(not(target_os = "linux"))]
fn load_cuda() -> Result<(), String> {
    Ok(())
}

/// Tells the C library to keep memory that tensors have given back for the next ones. It would return
/// large pieces to the system each time, and get them back page by page: a tenth of all time. It is for
/// programs to call, once, before they train.
pub fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        let set = |what, bytes| {
            #[allow(unsafe_code, reason = "a function of the C library that takes two numbers")]
            // SAFETY: mallopt may be called at any time, and refuses what it cannot do.
            let done = unsafe { libc::mallopt(what, bytes) };
            done == 1
        };
        // Older versions refuse more than the second.
        let _ = [1 << 30, 32 << 20].iter().any(|&bytes| set(libc::M_MMAP_THRESHOLD, bytes));
        let _ = set(libc::M_TRIM_THRESHOLD, 1 << 30);
    }
}

/// Has libtorch compute on this thread and no more of its own than rayon has, which knows what was asked for;
/// returns how many that are.
#[must_use]
pub fn limit_threads() -> usize {
    let threads = (tch::get_num_threads().max(1) as usize).min(rayon::current_num_threads());
    tch::set_num_threads(threads as i32);
    threads
}

/// What a network computes with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Computing {
    /// `Float` or `BFloat16`.
    pub kind: Kind,
}

impl Computing {
    /// The kind of numbers that a configuration asks for on a device.
    #[must_use]
    pub fn new(precision: Precision, device: Device) -> Self {
        #[cfg(target_arch = "x86_64")]
        let native = std::arch::is_x86_feature_detected!("avx512bf16");
        #[cfg(not(target_arch = "x86_64"))]
        let native = false;
        let kind = match precision {
            Precision::Bfloat16 => Kind::BFloat16,
            Precision::Auto if native || device.is_cuda() => Kind::BFloat16,
            _ => Kind::Float,
        };
        Self { kind }
    }
}

/// Numbers on a device. A graphics card gets them while it is still busy with what came before.
pub(super) fn upload<T: Element>(numbers: &[T], device: Device) -> Tensor {
    let tensor = Tensor::from_slice(numbers);
    let kind = tensor.kind();
    tensor.to_device_(device, kind, true, false)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cpu_is_always_there_and_cuda_is_told_apart() {
        assert_eq!(DeviceChoice::Cpu.device(), Ok(Device::Cpu));
        match DeviceChoice::Cuda.device() {
            Ok(device) => assert_eq!(DeviceChoice::Auto.device(), Ok(device)),
            Err(error) => {
                assert!(error.to_string().contains("--device cpu"), "{error}");
                assert_eq!(DeviceChoice::Auto.device(), Ok(Device::Cpu));
            }
        }
    }
}
