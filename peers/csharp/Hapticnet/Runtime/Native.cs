using System;
using System.Runtime.InteropServices;
using System.Text;
using Microsoft.Win32.SafeHandles;

namespace Hapticnet
{
    /// <summary>Marks a method that native code calls, for compilers ahead of time, such as Unity's IL2CPP.</summary>
    [AttributeUsage(AttributeTargets.Method)]
    internal sealed class MonoPInvokeCallbackAttribute : Attribute
    {
        internal MonoPInvokeCallbackAttribute(Type type)
        {
        }
    }

    /// <summary>The functions of libhapticnet. Sizes and names are the library's own.</summary>
    internal static class Native
    {
#if UNITY_IOS && !UNITY_EDITOR
        private const string Library = "__Internal";
#else
        private const string Library = "hapticnet";
#endif

        [UnmanagedFunctionPointer(CallingConvention.Cdecl)]
        internal delegate uint Entropy(IntPtr context);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern MasterHandle hn_make_master(byte[] codec, byte[] name, IntPtr[] names, double[] values,
            UIntPtr count, Entropy entropy, IntPtr context, byte[] wrong);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern void hn_free_master(IntPtr master);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern IntPtr hn_seal_master(MasterHandle master, byte[] own, byte[] slave, byte[] psk);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern void hn_master_tick(MasterHandle master, double[] position_m, long now_us);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern void hn_master_force(MasterHandle master, double[] force_n, long now_us);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern UIntPtr hn_master_send(MasterHandle master, byte[] datagram);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern void hn_master_receive(MasterHandle master, byte[] datagram, UIntPtr size, long now_us);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern void hn_master_close(MasterHandle master, byte[] reason, long now_us);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern int hn_master_state(MasterHandle master);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern IntPtr hn_master_reason(MasterHandle master, out uint code);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern IntPtr hn_master_scene(MasterHandle master);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern uint hn_master_count(MasterHandle master, byte[] name);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern SlaveHandle hn_make_slave(byte[] scene, uint axes, Entropy entropy, IntPtr context,
            byte[] wrong);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern void hn_free_slave(IntPtr slave);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern IntPtr hn_seal_slave(SlaveHandle slave, byte[] own, byte[] masters, UIntPtr count);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern UIntPtr hn_slave_receive(SlaveHandle slave, byte[] datagram, UIntPtr size,
            byte[] address, UIntPtr address_size, long now_us, byte[] answer);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        [return: MarshalAs(UnmanagedType.I1)]
        internal static extern bool hn_slave_position(SlaveHandle slave, double[] position_m);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern UIntPtr hn_slave_answer(SlaveHandle slave, double[] force_n, long now_us, byte[] answer);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern UIntPtr hn_slave_close(SlaveHandle slave, byte[] reason, uint code, byte[] datagram);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern IntPtr hn_slave_master(SlaveHandle slave, out UIntPtr size);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern uint hn_slave_count(SlaveHandle slave, byte[] name);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern IntPtr hn_read_key(byte[] path, byte[] own, byte[] psk, byte[] wrong);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern IntPtr hn_read_masters(byte[] path, byte[] masters, UIntPtr most, out UIntPtr count,
            byte[] wrong);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        [return: MarshalAs(UnmanagedType.I1)]
        internal static extern bool hn_derive_public(byte[] found, byte[] own);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern IntPtr hn_codec_name(uint index);

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern UIntPtr hn_datagram_bytes();

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern UIntPtr hn_error_bytes();

        [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
        internal static extern uint hn_most_axes();

        /// <summary>Return a text as the library takes it: UTF-8 that ends with a zero. Null stays null.</summary>
        internal static byte[] Bytes(string text)
        {
            return text == null ? null : Encoding.UTF8.GetBytes(text + "\0");
        }

        /// <summary>Return a text of the library. Null stays null.</summary>
        internal static string Text(IntPtr text)
        {
            if (text == IntPtr.Zero)
                return null;
            int size = 0;
            while (Marshal.ReadByte(text, size) != 0)
                size++;
            var bytes = new byte[size];
            Marshal.Copy(text, bytes, 0, size);
            return Encoding.UTF8.GetString(bytes);
        }

        /// <summary>Throw what the library wrote, unless it made a node.</summary>
        internal static void Check(NodeHandle made, byte[] wrong)
        {
            if (made.IsInvalid)
                throw new HapticException(Encoding.UTF8.GetString(wrong, 0, Array.IndexOf(wrong, (byte)0)));
        }

        /// <summary>Throw what the library says is wrong; null: nothing is.</summary>
        internal static void Check(IntPtr wrong)
        {
            if (wrong != IntPtr.Zero)
                throw new HapticException(Text(wrong));
        }

        /// <summary>Return what a call returns; without the library, say how to get it.</summary>
        internal static T Loaded<T>(Func<T> call)
        {
            try
            {
                return call();
            }
            catch (DllNotFoundException)
            {
                throw new HapticException("the library 'hapticnet' is not found; build it with 'make -C peers/c shared'"
                    + " and put it where programs look for libraries (in Unity: the package's folder Plugins)");
            }
            catch (EntryPointNotFoundException error)
            {
                throw new HapticException("the library 'hapticnet' is of another version than this package: "
                    + error.Message);
            }
        }
    }

    /// <summary>A source of random numbers that native code calls.</summary>
    internal sealed class RandomSource
    {
        internal static readonly Native.Entropy Callback = Draw; // kept, because native code keeps a pointer to it

        private readonly Func<uint> _random;

        internal RandomSource(Func<uint> random)
        {
            _random = random;
        }

        /// <summary>What it threw, because exceptions must not pass through native code.</summary>
        internal Exception Failure { get; private set; }

        [MonoPInvokeCallback(typeof(Native.Entropy))]
        private static uint Draw(IntPtr context)
        {
            var source = (RandomSource)GCHandle.FromIntPtr(context).Target;
            try
            {
                return source._random();
            }
            catch (Exception error)
            {
                source.Failure = error;
                return 0;
            }
        }

        /// <summary>Throw if random numbers failed: what was made of them must not be sent.</summary>
        internal void Check()
        {
            if (Failure != null)
                throw new HapticException("the source of random numbers failed: " + Failure.Message);
        }
    }

    internal abstract class NodeHandle : SafeHandleZeroOrMinusOneIsInvalid
    {
        private GCHandle _kept;

        protected NodeHandle()
            : base(true)
        {
        }

        /// <summary>Keep what native code points to until this is released.</summary>
        internal void Keep(GCHandle kept)
        {
            _kept = kept;
        }

        protected override bool ReleaseHandle()
        {
            Free(handle);
            if (_kept.IsAllocated)
                _kept.Free();
            return true;
        }

        protected abstract void Free(IntPtr node);
    }

    internal sealed class MasterHandle : NodeHandle
    {
        protected override void Free(IntPtr node)
        {
            Native.hn_free_master(node);
        }
    }

    internal sealed class SlaveHandle : NodeHandle
    {
        protected override void Free(IntPtr node)
        {
            Native.hn_free_slave(node);
        }
    }
}
