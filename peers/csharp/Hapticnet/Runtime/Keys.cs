using System;
using System.Collections.Generic;

namespace Hapticnet
{
    /// <summary>A host's own key and, if there is one, the key that it shares with its peer. Dispose overwrites both.
    /// </summary>
    public sealed class PrivateKey : IDisposable
    {
        /// <summary>The size of a key.</summary>
        public const int Bytes = 32;

        /// <summary>Make one of 32 bytes, and those of a shared key or null.</summary>
        public PrivateKey(byte[] own, byte[] psk = null)
        {
            CheckLength(own, "the private key");
            Own = (byte[])own.Clone();
            if (psk != null)
                CheckLength(psk, "the shared key");
            Psk = psk == null ? new byte[Bytes] : (byte[])psk.Clone();
        }

        /// <summary>The public key, which the peer needs.</summary>
        public byte[] PublicKey
        {
            get
            {
                var found = new byte[Bytes];
                if (!Native.Loaded(() => Native.hn_derive_public(found, Own)))
                    throw new HapticException("libcrypto lacks X25519, as in FIPS mode");
                return found;
            }
        }

        internal byte[] Own { get; private set; }

        internal byte[] Psk { get; private set; }

        internal bool HasPsk
        {
            get { return Array.Exists(Psk, each => each != 0); }
        }

        /// <summary>Read the file that 'hapticnet key new' made; null: ~/.config/hapticnet/key.toml.</summary>
        /// <exception cref="HapticException">It is missing or wrong, or others than its owner can read it.</exception>
        public static PrivateKey Load(string path = null)
        {
            byte[] own = new byte[Bytes], psk = new byte[Bytes];
            var wrong = new byte[(int)Native.Loaded(Native.hn_error_bytes)];
            Native.Check(Native.hn_read_key(Native.Bytes(path), own, psk, wrong));
            var key = new PrivateKey(own, psk);
            Array.Clear(own, 0, own.Length);
            Array.Clear(psk, 0, psk.Length);
            return key;
        }

        /// <summary>Return the 32 bytes of a key that is written as 44 characters of base64.</summary>
        public static byte[] Parse(string text)
        {
            byte[] key = null;
            try
            {
                key = Convert.FromBase64String(text ?? "");
            }
            catch (FormatException)
            {
            }
            if (key == null || key.Length != Bytes || Format(key) != text) // a key has one spelling
                throw new HapticException("a key is 44 characters of base64 that end in '=' (32 bytes); this has "
                    + (text ?? "").Length + " characters");
            return key;
        }

        /// <summary>Return a key as 44 characters of base64.</summary>
        public static string Format(byte[] key)
        {
            return Convert.ToBase64String(key);
        }

        /// <inheritdoc/>
        public void Dispose()
        {
            Array.Clear(Own, 0, Own.Length);
            Array.Clear(Psk, 0, Psk.Length);
        }

        internal static void CheckLength(byte[] key, string what)
        {
            if (key == null || key.Length != Bytes)
                throw new HapticException(what + " has " + (key == null ? 0 : key.Length) + " bytes; a key has 32");
        }
    }

    /// <summary>A master that a slave serves.</summary>
    public sealed class ListedMaster
    {
        /// <summary>Make one of its public key, and the key that both share or null.</summary>
        public ListedMaster(byte[] publicKey, byte[] psk = null)
        {
            PrivateKey.CheckLength(publicKey, "a master's public key");
            if (psk != null)
                PrivateKey.CheckLength(psk, "a shared key");
            PublicKey = publicKey;
            Psk = psk;
        }

        /// <summary>Its public key, 32 bytes.</summary>
        public byte[] PublicKey { get; private set; }

        /// <summary>The key that both share; null or zeros: none.</summary>
        public byte[] Psk { get; private set; }

        /// <summary>Read a slave's list of masters; null: ~/.config/hapticnet/masters.toml.</summary>
        public static IList<ListedMaster> Load(string path = null)
        {
            const int most = 1000;
            var listed = new byte[64 * most];
            var wrong = new byte[(int)Native.Loaded(Native.hn_error_bytes)];
            UIntPtr count;
            Native.Check(Native.hn_read_masters(Native.Bytes(path), listed, (UIntPtr)most, out count, wrong));
            var masters = new List<ListedMaster>();
            for (int i = 0; i < (int)count; i++)
            {
                byte[] publicKey = new byte[32], psk = new byte[32];
                Array.Copy(listed, 64 * i, publicKey, 0, 32);
                Array.Copy(listed, 64 * i + 32, psk, 0, 32);
                masters.Add(new ListedMaster(publicKey, psk));
            }
            return masters;
        }
    }
}
