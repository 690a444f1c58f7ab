//! An adapter that looks in the processor's place. Nothing that is found depends on it.

use super::Zcoll;
#[cfg(feature = "gpu")]
use super::{Contacts, Side, Surface};
#[cfg(feature = "gpu")]
use crate::gpu::{GpuError, GpuZcoll};
#[cfg(feature = "gpu")]
use nalgebra::Isometry3;

impl Zcoll {
    /// Looks on an adapter from now on, or no longer. Nothing that is found depends on it; if the
    /// adapter fails, one line is logged and the processor goes on.
    #[cfg(feature = "gpu")]
    pub fn set_gpu(&mut self, gpu: Option<GpuZcoll>) -> Option<GpuZcoll> {
        std::mem::replace(&mut self.gpu, gpu.map(Box::new)).map(|gpu| *gpu)
    }

    /// True while an adapter does the looking.
    pub fn is_on_gpu(&self) -> bool {
        #[cfg(feature = "gpu")]
        return self.gpu.is_some();
        #[cfg(not(feature = "gpu"))]
        false
    }

    /// Asks the adapter, if there is one; after an error there is none any more.
    #[cfg(feature = "gpu")]
    pub(super) fn ask_gpu<T>(&mut self, ask: impl FnOnce(&mut GpuZcoll) -> Result<T, GpuError>) -> Option<T> {
        match ask(self.gpu.as_mut()?) {
            Ok(answer) => Some(answer),
            Err(error) => {
                tracing::warn!("collision continues on the processor: {error}");
                self.gpu = None;
                None
            }
        }
    }

    /// A look of the adapter, if there is one, taken into the lists of this one.
    #[cfg(feature = "gpu")]
    pub(super) fn query_gpu(
        &mut self,
        side: &Side,
        instrument_from_eye: &Isometry3<f64>,
        surface: &Surface,
    ) -> Option<Contacts> {
        let found = self.ask_gpu(|gpu| gpu.query(side, instrument_from_eye, surface))?;
        let gpu = self.gpu.as_ref()?;
        self.hits.extend_from_slice(gpu.hits());
        for &(triangle, depth) in gpu.triangles() {
            self.triangles.push(triangle);
            self.triangle_depth[triangle as usize] = depth;
        }
        for &(node, depth) in gpu.displaced() {
            self.nodes.push(node);
            self.node_depth[node as usize] = depth;
        }
        Some(found)
    }
}
