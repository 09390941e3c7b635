//! Random numbers, which the library asks for by a callback.

use std::os::raw::c_void;
use std::panic::{catch_unwind, AssertUnwindSafe};
use std::process::abort;

use crate::sys;

/// A function that returns 32 unpredictable bits. If it panics, the program is aborted: there is no way back through C.
pub type Random = Box<dyn FnMut() -> u32 + Send>;

/// Return 32 bits of libcrypto's.
fn of_libcrypto() -> u32 {
    let mut bytes = [0; 4];
    // Safety: it writes 4 bytes.
    let good = unsafe { sys::RAND_bytes(bytes.as_mut_ptr(), 4) };
    assert!(good == 1, "libcrypto has no random numbers");
    u32::from_ne_bytes(bytes)
}

/// A source of random numbers at a place that stays.
pub(crate) struct Source(Box<Random>);

impl Source {
    pub(crate) fn new(random: Option<Random>) -> Source {
        Source(Box::new(random.unwrap_or_else(|| Box::new(of_libcrypto))))
    }

    pub(crate) fn context(&mut self) -> *mut c_void {
        let random: *mut Random = &mut *self.0;
        random.cast()
    }
}

/// What the library calls with such a context.
pub(crate) unsafe extern "C" fn draw(context: *mut c_void) -> u32 {
    let random = &mut *context.cast::<Random>();
    catch_unwind(AssertUnwindSafe(random)).unwrap_or_else(|_| abort())
}
