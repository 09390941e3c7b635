//! The functions of libhapticnet, as ../c/shared/hapticnet_binding.h and ../c/include/hapticnet.h declare them.

use std::os::raw::{c_char, c_int, c_uint, c_void};

/// A master that the library keeps.
#[repr(C)]
pub struct Master {
    _private: [u8; 0],
}

/// A slave that the library keeps.
#[repr(C)]
pub struct Slave {
    _private: [u8; 0],
}

pub type Entropy = unsafe extern "C" fn(context: *mut c_void) -> u32;

extern "C" {
    pub fn hn_make_master(
        codec: *const c_char,
        name: *const c_char,
        names: *const *const c_char,
        values: *const f64,
        count: usize,
        entropy: Entropy,
        context: *mut c_void,
        wrong: *mut c_char,
    ) -> *mut Master;
    pub fn hn_free_master(m: *mut Master);
    pub fn hn_seal_master(m: *mut Master, own: *const u8, slave: *const u8, psk: *const u8) -> *const c_char;
    pub fn hn_master_tick(m: *mut Master, position_m: *const f64, now_us: i64);
    pub fn hn_master_force(m: *mut Master, force_n: *mut f64, now_us: i64);
    pub fn hn_master_send(m: *mut Master, datagram: *mut u8) -> usize;
    pub fn hn_master_receive(m: *mut Master, datagram: *const c_void, size: usize, now_us: i64);
    pub fn hn_master_close(m: *mut Master, reason: *const c_char, now_us: i64);
    pub fn hn_master_state(m: *const Master) -> c_int;
    pub fn hn_master_reason(m: *const Master, code: *mut c_uint) -> *const c_char;
    pub fn hn_master_scene(m: *const Master) -> *const c_char;
    pub fn hn_master_count(m: *const Master, name: *const c_char) -> u32;

    pub fn hn_make_slave(
        scene: *const c_char,
        axes: c_uint,
        entropy: Entropy,
        context: *mut c_void,
        wrong: *mut c_char,
    ) -> *mut Slave;
    pub fn hn_free_slave(s: *mut Slave);
    pub fn hn_seal_slave(s: *mut Slave, own: *const u8, masters: *const u8, count: usize) -> *const c_char;
    pub fn hn_slave_receive(
        s: *mut Slave,
        datagram: *const c_void,
        size: usize,
        address: *const c_void,
        address_size: usize,
        now_us: i64,
        answer: *mut u8,
    ) -> usize;
    pub fn hn_slave_position(s: *const Slave, position_m: *mut f64) -> bool;
    pub fn hn_slave_answer(s: *mut Slave, force_n: *const f64, now_us: i64, answer: *mut u8) -> usize;
    pub fn hn_slave_close(s: *mut Slave, reason: *const c_char, code: c_uint, datagram: *mut u8) -> usize;
    pub fn hn_slave_master(s: *const Slave, size: *mut usize) -> *const c_void;
    pub fn hn_slave_count(s: *const Slave, name: *const c_char) -> u32;

    pub fn hn_read_key(path: *const c_char, own: *mut u8, psk: *mut u8, wrong: *mut c_char) -> *const c_char;
    pub fn hn_read_masters(
        path: *const c_char,
        masters: *mut u8,
        most: usize,
        count: *mut usize,
        wrong: *mut c_char,
    ) -> *const c_char;
    pub fn hn_parse_key(key: *mut u8, text: *const c_char) -> bool;
    pub fn hn_derive_public(public: *mut u8, own: *const u8) -> bool;
    pub fn hn_codec_name(index: c_uint) -> *const c_char;
    pub fn hn_error_bytes() -> usize;

    /// Of libcrypto.
    pub fn RAND_bytes(bytes: *mut u8, size: c_int) -> c_int;
}
